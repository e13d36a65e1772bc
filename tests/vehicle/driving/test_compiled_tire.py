"""The compiled tire against `MagicFormula`, within its ranges and beyond them."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from miho.vehicle.data import embedded_tire
from miho.vehicle.driving.compiled_tire import wheel_forces, wheel_tire
from miho.vehicle.driving.compiling import compiled
from miho.vehicle.models import load_tir
from miho.vehicle.models.magic_formula import MagicFormula

FILES = ("lf", "rf", "lr", "rr", "reference_tire_tvd3", "MagicFormula52_Parameters")


@cache
def tire(name: str, folder: Path) -> MagicFormula:
    path = embedded_tire(name) if len(name) == 2 else folder / "mf_reference" / f"{name}.tir"
    return load_tir(path, strict=False)


@compiled
def forces(p, load, kappa, alpha, Vx):  # type: ignore[no-untyped-def]
    values = np.empty((2, load.size))
    for i in range(load.size):
        values[0, i], values[1, i] = wheel_forces(p, load[i], kappa[i], alpha[i], Vx[i])
    return values


def compare(model: MagicFormula, gamma: float, pressure: float | None = None) -> None:
    """Combined slip at 2000 random conditions: a lifted wheel and clamped inputs are among them.

    1e-9 of the largest force is asked for; they differ by rounding.
    """
    rng = np.random.default_rng(0)
    size = np.array([0.1, 1.0])
    load, Vx = rng.uniform(-500, 11000, 2000), rng.uniform(0.1, 90, 2000)
    kappa = rng.uniform(-1.2, 1.2, 2000) * rng.choice(size, 2000)
    alpha = rng.uniform(-0.8, 0.8, 2000) * rng.choice(size, 2000)
    expected = model.forces(load, kappa, alpha, gamma, Vx, pressure)
    calculated = forces(wheel_tire(model, gamma, pressure), load, kappa, alpha, Vx)
    for force, reference in zip(calculated, (expected.Fx, expected.Fy), strict=True):
        np.testing.assert_allclose(force, reference, rtol=0, atol=1e-12 * np.abs(reference).max())


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("gamma", [-0.0436, 0.0, 0.3])
def test_equals_the_magic_formula(name: str, gamma: float, reference_data: Path) -> None:
    compare(tire(name, reference_data), gamma, 1.2e5)


@pytest.mark.parametrize("name", FILES[:4])
def test_equals_it_at_nominal_pressure(name: str) -> None:
    compare(tire(name, Path()), -0.02)


def test_every_choice_and_term() -> None:
    """Scaling factors, slipperiness with speed, unclamped curves and inputs, a smallest load."""
    lf = tire("lf", Path())
    scaled = replace(
        lf.parameters, LMUV=0.1, LMUX=0.8, LMUY=0.7, LKX=1.1, LKY=0.9, LFZO=1.2, LXAL=1.3, LYKA=0.8,
        LVYKA=1.2, LKYC=0.7, LEX=0.9, LEY=1.1, LCX=0.97, LCY=1.03, LHX=2.0, LHY=0.5, LVX=1.4,
        LVY=0.6, FZMIN=600.0, REX1=1.4, REY1=1.3,
    )  # fmt: skip
    compare(replace(lf, parameters=scaled, A_mu=10.0), -0.05)
    compare(replace(lf, parameters=scaled, clamp_curvature=False), 0.05)
    compare(replace(lf, fade_at_standstill=True, epsilon=1.0), 0.05)
    compare(replace(lf, parameters=replace(scaled, FZMIN=0.0), clamp_inputs=False), 0.05)


def test_an_inclination_that_is_no_angle() -> None:
    with pytest.raises(ValueError, match=r"^inclination is nan; expected a finite angle"):
        wheel_tire(tire("lf", Path()), float("nan"))
