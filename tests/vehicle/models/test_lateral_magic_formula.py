"""The identifiable Magic Formula: its force, derivatives, identification and its way to a file."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from miho import CurveFit, Dataset, Parameter, Space
from miho.quantities import Array
from miho.testing import check_model
from miho.vehicle.data import embedded_tire, sample_lateral
from miho.vehicle.models import LateralMagicFormula, load_tir, mf61_lateral, write_tir
from miho.vehicle.models.lateral_magic_formula import COEFFICIENTS
from miho.vehicle.models.magic_formula import MagicFormula

BASE = {"FNOMIN": 3114.0, "NOMPRES": 145000.0, "UNLOADED_RADIUS": 0.304, "LONGVL": 40.0}
LF = load_tir(embedded_tire("lf"))


def coefficients(tire: MagicFormula) -> Array:
    return np.array([getattr(tire.parameters, name) for name in COEFFICIENTS])


def conditions(n: int = 400, seed: int = 0) -> tuple[Array, ...]:
    rng = np.random.default_rng(seed)
    low, high = [-0.3, 100, -0.1, 1e5], [0.3, 8000, 0.1, 2e5]
    return tuple(rng.uniform(low, high, (n, 4)).T)


def force(tire: MagicFormula, alpha: Array, Fz: Array, gamma: Array, pressure: Array) -> Array:
    return tire.forces(Fz, 0.0, alpha, gamma, pressure=pressure).Fy


def bare(tire: MagicFormula) -> LateralMagicFormula:
    model = mf61_lateral({name: getattr(tire.parameters, name) for name in BASE})
    assert isinstance(model, LateralMagicFormula)
    return model


@pytest.mark.parametrize("name", ["lf", "rr"])
def test_it_is_the_tires_own_force_without_slip_ratio(name: str) -> None:
    tire = load_tir(embedded_tire(name))
    inputs = conditions()
    predicted = bare(tire).predict(coefficients(tire)[None], *inputs)[0]
    assert np.array_equal(predicted, force(tire, *inputs))


def test_derivatives_and_batches() -> None:
    rng = np.random.default_rng(1)
    thetas = coefficients(LF) * rng.uniform(0.6, 1.4, (4, len(COEFFICIENTS)))
    check_model(LateralMagicFormula(LF), thetas, *conditions())


def test_derivatives_with_scaling_factors_and_a_base_beyond_its_ranges() -> None:
    """Loads below FZMIN, E held at 1, friction that decays with speed, and every scaling factor."""
    factors = dict.fromkeys(("LCY", "LEY", "LKY", "LHY", "LVY", "LKYC", "LMUY", "LFZO"), 0.8)
    p = replace(LF.parameters, FZMIN=1000.0, FZMAX=5000.0, LMUV=0.2, **factors)
    base = replace(LF, parameters=p, A_mu=10.0)
    thetas = np.stack([coefficients(LF), coefficients(LF)])
    thetas[1, list(COEFFICIENTS).index("PEY1")] = 1.1
    check_model(LateralMagicFormula(base), thetas, *conditions())
    free = replace(base, clamp_curvature=False)
    check_model(LateralMagicFormula(free), thetas, *conditions())


def test_it_is_linear_where_it_says_so() -> None:
    """PVY1 and PVY2 enter at any value as their derivative says; PVY3 does not."""
    model, inputs = LateralMagicFormula(LF), conditions()
    theta = coefficients(LF)
    assert model.linear == ("PVY1", "PVY2")
    J = model.jacobian(theta, *inputs)
    for name in (*model.linear, "PVY3"):
        k = list(COEFFICIENTS).index(name)
        step = 3.0 * (np.arange(theta.size) == k)
        change = model.predict((theta + step)[None], *inputs)[0] - force(LF, *inputs)
        assert np.allclose(change, 3.0 * J[:, k], rtol=1e-9, atol=1e-7) is (name != "PVY3")


def test_some_coefficients_are_identified_and_the_others_are_the_bases() -> None:
    names = ("PKY1", "PVY1", "PCY1")
    model = LateralMagicFormula(LF, names)
    theta = np.array([-53.0, 0.058, 1.54])
    assert list(model.parameters.items()) == [("PKY1", "1/rad"), ("PVY1", "-"), ("PCY1", "-")]
    assert model.linear == ("PVY1",)
    inputs = conditions()[:3]
    nominal = np.full(inputs[0].size, LF.parameters.NOMPRES)
    assert np.array_equal(model.predict(theta[None], *inputs)[0], force(LF, *inputs, nominal))
    check_model(model, theta[None], *inputs)
    assert model.with_coefficients(theta) == LF


@pytest.mark.parametrize("name", ["lf", "rf", "lr", "rr"])
def test_it_is_identified_from_noisy_data_and_holds_elsewhere(name: str) -> None:
    """27 coefficients, from the middle of a wide range to 0.05 % of the peak where unseen."""
    tire, data = load_tir(embedded_tire(name)), sample_lateral(name)
    assert len(data) == 3000
    model = bare(tire)
    inputs = [data[name] for name in model.inputs]
    typical = {"PCY1": 1.5, "PDY1": 1.0, "PEY1": -1.0, "PKY1": -30.0, "PKY2": 2.0, "PKY4": 2.0}
    solution = least_squares(
        lambda theta: model.predict(theta[None], *inputs)[0] - data["Fy"],
        [typical.get(name, 0.0) for name in COEFFICIENTS],
        jac=lambda theta: model.jacobian(theta, *inputs),
        x_scale="jac",
    )
    held = data.held_out
    assert held is not None
    unseen = [held[name] for name in model.inputs]
    truth = force(tire, *unseen)
    error = np.sqrt(np.mean((model.predict(solution.x[None], *unseen)[0] - truth) ** 2))
    assert error < 0.00055 * np.abs(truth).max()
    assert np.sqrt(2 * solution.cost / len(data)) == pytest.approx(50, rel=0.05), (
        "the noise is left"
    )


def test_a_file_of_the_identified_tire_gives_the_same_forces(tmp_path: Path) -> None:
    model, theta = bare(LF), coefficients(LF) * 1.01
    tire = model.with_coefficients(theta)
    write_tir(tire, tmp_path / "identified.tir")
    again = load_tir(tmp_path / "identified.tir")
    assert again == tire
    inputs = conditions()
    assert np.array_equal(force(again, *inputs), model.predict(theta[None], *inputs)[0])
    assert not again.forces(3000, 0.1, 0).Fx, "nothing is known of its longitudinal force"


def test_what_a_file_cannot_hold_is_not_written(tmp_path: Path) -> None:
    model, theta = LateralMagicFormula(LF), coefficients(LF)
    theta[3] = np.nan
    with pytest.raises(ValueError, match="PDY3 is nan"):
        write_tir(model.with_coefficients(theta), tmp_path / "nan.tir")
    write_tir(bare(LF).base, tmp_path / "free.tir")
    assert load_tir(tmp_path / "free.tir") == bare(LF).base, "no ranges: they do not limit"


@pytest.mark.slow
def test_the_reference_tire_is_identified_again(reference_data: Path) -> None:
    """A tire nobody here wrote, from noise-free samples, to 1e-9 of its largest force."""
    path = reference_data / "mf_reference" / "reference_tire_tvd3.tir"
    tire = load_tir(path)
    data = sample_lateral(path, n=1500, noise=0.0)
    model = bare(tire)
    inputs = [data[name] for name in model.inputs]
    typical = {"PCY1": 1.5, "PDY1": 1.0, "PEY1": -1.0, "PKY1": -30.0, "PKY2": 2.0, "PKY4": 2.0}
    solution = least_squares(
        lambda theta: model.predict(theta[None], *inputs)[0] - data["Fy"],
        [typical.get(name, 0.0) for name in COEFFICIENTS],
        jac=lambda theta: model.jacobian(theta, *inputs),
        x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14,
    )  # fmt: skip
    held = data.held_out
    assert held is not None
    identified = model.with_coefficients(solution.x)
    error = force(identified, *(held[name] for name in model.inputs)) - held["Fy"]
    assert np.abs(error).max() < 1e-9 * np.abs(held["Fy"]).max()
    np.testing.assert_allclose(solution.x, coefficients(tire), rtol=1e-5, atol=1e-7)


def test_a_path_is_a_base_and_the_source(tmp_path: Path) -> None:
    path = tmp_path / "mine.tir"
    write_tir(LF, path)
    model = mf61_lateral(str(path), ["PCY1"])
    assert isinstance(model, LateralMagicFormula)
    assert (model.base, model.source, model.identified) == (LF, path, ("PCY1",))
    assert pickle.loads(pickle.dumps(model)) == model


@pytest.mark.parametrize(
    ("base", "identified", "message"),
    [
        ({"FNOMIN": 3000.0}, None, "base lacks NOMPRES"),
        (BASE, ["PDY1"], "base lacks PCY1"),
        (BASE | {"PHY3": 0.1}, None, "base has PHY3: 0.1"),
        (BASE | {"PVY1": "x"}, None, "base has PVY1: 'x'"),
        (BASE, ["PCY1", "PDY1", "PKY1", "PKY2", "PCY1"], "'PCY1', which is unknown or given twice"),
        (BASE | {"PCY1": 1.5, "PDY1": 1, "PKY1": -9, "PKY2": 2}, [], "identified is empty"),
        (BASE | {"FNOMIN": -1}, None, "FNOMIN: -1.0 is not a positive number"),
    ],
)
def test_bad_settings_are_named(
    base: dict[str, float], identified: list[str] | None, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        mf61_lateral(base, identified)


def test_a_tire_of_mf_52_is_no_base() -> None:
    old = replace(LF, parameters=replace(LF.parameters, version="5.2"))
    with pytest.raises(ValueError, match=r"MF 5\.2; expected MF 6\.1"):
        LateralMagicFormula(old)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"FNOMIN": 400.0},
            r"FNOMIN is 400 N, but Fz is [\d.]+ to [\d.]+ N in .*; choose FNOMIN near",
        ),
        ({"NOMPRES": 2e6}, r"NOMPRES is 2e\+06 Pa, but pressure is .*; choose NOMPRES near"),
    ],
)
def test_nominal_values_far_from_the_data_are_told(changes: dict[str, float], message: str) -> None:
    rng = np.random.default_rng(4)
    base = {"FNOMIN": 3000.0, "NOMPRES": 2e5, "UNLOADED_RADIUS": 0.3, "LONGVL": 16.7}
    columns = {
        "alpha": rng.uniform(-0.2, 0.2, 50), "Fz": rng.uniform(2000, 5000, 50),
        "gamma": np.zeros(50), "pressure": rng.uniform(1.8e5, 2.4e5, 50),
    }  # fmt: skip
    units = {"alpha": "rad", "Fz": "N", "gamma": "rad", "pressure": "Pa", "Fy": "N"}
    data = Dataset("rig", columns | {"Fy": -3e4 * columns["alpha"]}, units, "Fy")
    names = {"PCY1": (1, 2), "PDY1": (0.5, 2), "PKY1": (-90, -5), "PKY2": (1, 3), "PPY1": (-2, 2)}
    space = Space(tuple(Parameter(name, COEFFICIENTS[name], *box) for name, box in names.items()))
    CurveFit(mf61_lateral(base, tuple(names)), data, space)
    with pytest.warns(UserWarning, match=message):
        CurveFit(mf61_lateral(base | changes, tuple(names)), data, space)
