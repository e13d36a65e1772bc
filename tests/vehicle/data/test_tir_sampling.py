from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from miho.identification import irreducible_error
from miho.vehicle.data.tir_sampling import (
    EMBEDDED_RANGES,
    SamplingRanges,
    embedded_tire,
    sample_axle,
    sample_lateral,
    sample_tir,
    unmodelled_spread,
)
from miho.vehicle.models.tir import load_tir
from miho.vehicle.models.tir_reader import read_tir


def best_fit(alpha: NDArray[np.float64], Fy: NDArray[np.float64]) -> tuple[float, list[float]]:
    """RMSE [N] and (B, C, D, Sx, Sy) of Fy = D sin(C atan(B (Sx - alpha))) + Sy (Eq. 4)."""

    def residuals(theta: NDArray[np.float64]) -> NDArray[np.float64]:
        B, C, D, Sx, Sy = theta
        return np.asarray(D * np.sin(C * np.arctan(B * (Sx - alpha))) + Sy - Fy)

    rng = np.random.default_rng(0)
    starts = rng.uniform([5, 1.1, 2000, -0.02, -300], [25, 2.0, 7000, 0.02, 300], (6, 5))
    scale = np.array([10, 1, 4000, 0.01, 200])
    fits = [least_squares(residuals, start, x_scale=scale) for start in starts]
    best = min(fits, key=lambda fit: float(fit.cost))
    return float(np.sqrt(2 * best.cost / alpha.size)), list(best.x)


def test_left_front_has_the_papers_terminal_error() -> None:
    data = sample_tir("lf")
    rmse, _ = best_fit(data["alpha"], data["Fy"])
    floor = unmodelled_spread("lf")
    assert 385 < floor < 395
    assert 385 < rmse < 395
    assert 0.97 < rmse / floor < 1.05


@pytest.mark.parametrize("name", EMBEDDED_RANGES)
def test_fitted_curve_looks_like_a_racing_tire(name: str) -> None:
    data = sample_tir(name)
    _, (B, C, D, Sx, Sy) = best_fit(data["alpha"], data["Fy"])
    assert 8 < B < 20
    assert 1.2 < C < 1.8
    assert 1.3 < D / data["Fz"].mean() < 1.8
    assert 0.002 < abs(Sx) < 0.02, "the oval asymmetry"
    assert 50 < Sy < 400, "more force to the left"


def test_dataset_states_its_columns_units_and_signs() -> None:
    data = sample_tir("rf", n=500)
    assert data.name == "tire_rf"
    assert data.output == "Fy"
    assert dict(data.units) == {"alpha": "rad", "Fz": "N", "gamma": "rad", "kappa": "1", "Fy": "N"}
    assert len(data) == 500
    assert np.corrcoef(data["alpha"], data["Fy"])[0, 1] < -0.7


def test_samples_are_the_tires_own_forces_within_the_ranges() -> None:
    ranges = SamplingRanges(Fz=(1000, 2000), gamma=(-0.01, 0.02), alpha=(0, 0.1), kappa=(0, 0))
    data = sample_tir(embedded_tire("rr"), n=200, ranges=ranges)
    assert data.name == "tire_rr"
    for key in ("Fz", "gamma", "alpha", "kappa"):
        low, high = getattr(ranges, key)
        assert low <= data[key].min() and data[key].max() <= high
    inputs = {key: data[key] for key in ("Fz", "kappa", "alpha", "gamma")}
    np.testing.assert_array_equal(data["Fy"], load_tir(embedded_tire("rr")).forces(**inputs).Fy)


def test_the_seed_decides_the_sample() -> None:
    assert sample_tir("lf").digest == sample_tir("lf", seed=0).digest
    assert sample_tir("lf").digest != sample_tir("lf", seed=1).digest


def test_all_wheels_lean_into_the_left_turn() -> None:
    """ISO-W: a wheel whose top leans to the left has a negative inclination angle."""
    for ranges in EMBEDDED_RANGES.values():
        assert max(ranges.gamma) < 0


@pytest.mark.parametrize("name", EMBEDDED_RANGES)
def test_the_estimate_from_neighbours_agrees_with_redrawing(name: str) -> None:
    """Two independent ways to the irreducible error: from the samples, and from the tire."""
    data = sample_tir(name)
    estimate = irreducible_error(data["alpha"], data["Fy"])
    assert estimate == pytest.approx(unmodelled_spread(name), rel=0.03)


def test_a_file_of_your_own_is_sampled_around_its_nominal_load() -> None:
    data = sample_tir(embedded_tire("lf"), n=2000, ranges={"alpha": [0.0, 0.1], "kappa": None})
    FNOMIN = load_tir(embedded_tire("lf")).parameters.FNOMIN
    assert data["Fz"].mean() == pytest.approx(FNOMIN, rel=0.01)
    assert data["alpha"].min() >= 0 and data["alpha"].max() <= 0.1
    assert abs(data["kappa"]).max() == pytest.approx(0.025, rel=0.01)


def test_nothing_unmodelled_leaves_no_error() -> None:
    fixed = SamplingRanges(Fz=(3000, 3000), gamma=(0.02, 0.02), kappa=(0, 0))
    assert unmodelled_spread("lf", fixed, n=50, redraws=10) == pytest.approx(0, abs=1e-9)


def test_unmodelled_spread_matches_a_closed_form() -> None:
    """At one slip angle the force is nearly linear in a narrow range of load."""
    ranges = SamplingRanges(Fz=(2990, 3010), gamma=(0, 0), alpha=(0.03, 0.03), kappa=(0, 0))
    tire = load_tir(embedded_tire("lf"))
    low, high = tire.forces([2990, 3010], 0, 0.03).Fy
    error = unmodelled_spread("lf", ranges, n=200, redraws=200)
    assert error == pytest.approx(abs(high - low) / np.sqrt(12), rel=0.02)


def test_embedded_tires_are_four_files_of_version_61() -> None:
    digests = set()
    for name in EMBEDDED_RANGES:
        path = embedded_tire(name)
        assert "Synthetic" in path.read_text(encoding="latin-1").splitlines()[0]
        assert load_tir(path).parameters.version == "6.1"
        digests.add(str(read_tir(path).sections))
    assert len(digests) == 4


def test_bad_arguments_are_named() -> None:
    with pytest.raises(ValueError, match=r"'xx'.*lf, rf, lr, rr"):
        embedded_tire("xx")
    with pytest.raises(ValueError, match=r"sampling range speed: .*name one of Fz, gamma"):
        sample_tir("lf", ranges={"speed": [1, 2]})
    with pytest.raises(ValueError, match="seed is -1"):
        sample_tir("lf", seed=-1)
    with pytest.raises(ValueError, match="at least one sample"):
        sample_tir("lf", n=0)
    with pytest.raises(ValueError, match="redraws 1"):
        unmodelled_spread("lf", redraws=1)
    with pytest.raises(ValueError, match=r"range of alpha is \(0\.2, 0\.1\)"):
        SamplingRanges(Fz=(1, 2), gamma=(0, 0), alpha=(0.2, 0.1))


def test_a_tire_test_keeps_its_conditions_and_holds_some_out() -> None:
    data = sample_lateral("lf", n=800, noise=30.0)
    held = data.held_out
    assert data.name == "tire_lf_conditions"
    assert held is not None and len(held) == 1000
    assert list(data.columns) == ["alpha", "Fz", "gamma", "pressure", "Fy"]
    for key in ("Fz", "gamma"):
        assert not set(data[key]) & set(held[key]), "unseen"
        assert data[key].min() < held[key].min() and held[key].max() < data[key].max()
    tire = load_tir(embedded_tire("lf"))
    for rows in (data, held):
        truth = tire.forces(rows["Fz"], 0, rows["alpha"], rows["gamma"], pressure=rows["pressure"])
        noise = rows["Fy"] - truth.Fy
        assert noise.std() == pytest.approx(30, rel=0.1)
        assert abs(noise.mean()) < 4, "5 standard errors of the smaller set"


def test_conditions_of_your_own() -> None:
    data = sample_lateral(
        embedded_tire("rr"), n=50, noise=0.0, alpha=[0.0, 0.1], loads=[2000, 4000],
        cambers=[0.0], pressures=[165000.0], held_out=20, held_out_loads=[3500],
    )  # fmt: skip
    held = data.held_out
    assert held is not None
    assert set(data["Fz"]) == {2000, 4000} and set(held["Fz"]) == {3500}
    assert data["alpha"].min() >= 0 and data["alpha"].max() <= 0.1
    assert set(held["gamma"]) == {0.0}, "nothing lies between one camber"
    assert sample_lateral("lf", n=9).digest == sample_lateral("lf", n=9).digest
    assert sample_lateral("lf", n=9).digest != sample_lateral("lf", n=9, seed=1).digest


def test_bad_conditions_are_named() -> None:
    with pytest.raises(ValueError, match=r"loads is \[\]; give finite numbers"):
        sample_lateral("lf", loads=[])
    with pytest.raises(
        ValueError, match=r"held_out_cambers is \[0.0\]; expected levels that the tr"
    ):
        sample_lateral("lf", held_out_cambers=[0.0])
    with pytest.raises(ValueError, match="noise is -1"):
        sample_lateral("lf", noise=-1)
    with pytest.raises(ValueError, match=r"sampling range alpha: \[0.1\]"):
        sample_lateral("lf", alpha=[0.1])
    with pytest.raises(ValueError, match="axle is 'middle'; expected one of front, rear"):
        sample_axle("middle")


@pytest.mark.parametrize(("axle", "tires"), [("front", ("lf", "rf")), ("rear", ("lr", "rr"))])
def test_an_axle_is_the_sum_of_its_tires(axle: str, tires: tuple[str, str]) -> None:
    data = sample_axle(axle)
    assert data.name == f"{axle}_axle"
    total = np.zeros(len(data))
    for side, name in zip(("left", "right"), tires, strict=True):
        Fz, gamma, kappa = (data[f"{key}_{side}"] for key in ("Fz", "gamma", "kappa"))
        total += load_tir(embedded_tire(name)).forces(Fz, kappa, data["alpha"], gamma).Fy
    np.testing.assert_allclose(data["Fy"], total, rtol=1e-12)


@pytest.mark.parametrize(("axle", "tires"), [("front", ("lf", "rf")), ("rear", ("lr", "rr"))])
def test_the_spreads_of_two_independent_wheels_add_in_squares(
    axle: str, tires: tuple[str, str]
) -> None:
    data = sample_axle(axle)
    expected = np.hypot(*(unmodelled_spread(name, n=300, redraws=200) for name in tires))
    assert irreducible_error(data["alpha"], data["Fy"]) == pytest.approx(expected, rel=0.03)
