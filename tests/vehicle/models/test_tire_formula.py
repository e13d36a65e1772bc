"""A tire of a property file as a model: the tire's own forces, their derivatives, bad input."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

import miho
from miho.quantities import Array
from miho.vehicle.data import embedded_tire
from miho.vehicle.models.magic_formula import MagicFormula
from miho.vehicle.models.magic_formula_parameters import CONSTANTS
from miho.vehicle.models.tire_formula import INPUTS, TireFormula, tire_formula

LF = miho.load_tir(embedded_tire("lf"))
OLD = replace(
    LF, parameters=replace(LF.parameters, **(CONSTANTS["5.2"] | {"version": "5.2", "PHY3": 0.02}))
)
COEFFICIENTS = {
    "Fx": ("PCX1", "PDX1", "PEX1", "PKX1", "PHX1", "PVX1", "RBX1", "RHX1", "LMUX"),
    "Fy": ("PCY1", "PDY1", "PDY3", "PEY1", "PEY3", "PKY1", "PKY2", "PVY3", "RBY1", "RVY1", "LMUY"),
    "Mz": ("QBZ1", "QDZ1", "QDZ6", "QEZ1", "QHZ1", "SSZ2", "PDY1", "PKX1"),
}
BOXES = {
    "kappa": (-0.2, 0.2), "alpha": (-0.2, 0.2), "Fz": (300.0, 6000.0), "gamma": (-0.07, 0.07),
    "Vx": (10.0, 60.0), "pressure": (1.2e5, 1.6e5),
}  # fmt: skip


def conditions(n: int = 200) -> dict[str, Array]:
    rng = np.random.default_rng(2)
    return {name: rng.uniform(*ends, n) for name, ends in BOXES.items()}


def forces(tire: MagicFormula, name: str, inputs: dict[str, Array], **changed: float) -> Array:
    of = replace(tire, parameters=replace(tire.parameters, **changed))
    force: Array = getattr(of.forces(**({"kappa": 0.0, "alpha": 0.0} | inputs)), name)
    return force


@pytest.mark.parametrize("tire", [LF, OLD], ids=["6.1", "5.2"])
@pytest.mark.parametrize("force", COEFFICIENTS)
def test_it_is_the_tire_with_exact_derivatives(force: str, tire: MagicFormula) -> None:
    """Differences of fourth order, h^4 and rounding / h: some 1e-11 of a derivative's size."""
    inputs, names = conditions(), COEFFICIENTS[force]
    model = tire_formula(tire, names, [*inputs, "Fy"], force)
    assert list(model.inputs) == list(INPUTS) == list(inputs)
    theta = np.array([*model.own_values().values()])
    values = model.predict(theta[None], *inputs.values())[0]
    np.testing.assert_allclose(values, forces(tire, force, inputs), rtol=1e-13, atol=1e-9)
    J = model.jacobian(theta, *inputs.values())
    for k, name in enumerate(names):
        h = 1e-3 * max(abs(theta[k]), 0.01)
        at = {m: forces(tire, force, inputs, **{name: theta[k] + m * h}) for m in (-2, -1, 1, 2)}
        slope = (8 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12 * h)
        size = np.abs(slope).max()
        assert size > 0
        np.testing.assert_allclose(J[:, k], slope, rtol=0, atol=1e-8 * size, err_msg=name)
    assert pickle.loads(pickle.dumps(model)) == model


def test_inputs_without_a_column_are_zero_or_the_files() -> None:
    inputs = {name: column for name, column in conditions().items() if name in ("alpha", "Fz")}
    model = tire_formula(LF, ["PDY1", "PVY1"], inputs, "Fy")
    theta = np.array([[1.5, 0.02]])
    expected = forces(LF, "Fy", inputs, PDY1=1.5, PVY1=0.02)
    np.testing.assert_allclose(model.predict(theta, *inputs.values())[0], expected, rtol=1e-13)
    assert model.linear == ("PVY1",)
    assert dict(model.parameters) == {"PDY1": "-", "PVY1": "-"}


def test_a_coefficient_is_named_once() -> None:
    with pytest.raises(ValueError, match=r"has 'PDY1', which is given twice or .* MF 6[.]1"):
        TireFormula(LF, ("PDY1", "PDY1"))
    with pytest.raises(ValueError, match="has 'PHY3', which is given twice or not a coefficient"):
        TireFormula(LF, ("PHY3",))
