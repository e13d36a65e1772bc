"""Lateral force of the full Magic Formula as a model with identified coefficients."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from typing import Any, cast

import numpy as np

from miho.models.derived import Derived
from miho.models.model import Model
from miho.models.symbolic import Symbol, constant, trace
from miho.models.traced import TracedExpression
from miho.quantities import Array
from miho.validate import is_number
from miho.vehicle.models.features import tire_features
from miho.vehicle.models.magic_formula import MagicFormula
from miho.vehicle.models.magic_formula_parameters import (
    CONSTANTS,
    MagicFormulaParameters,
    parameter_names,
    required_names,
)
from miho.vehicle.models.tir import load_tir

COEFFICIENTS = MappingProxyType(
    {
        "PCY1": "-", "PDY1": "-", "PDY2": "-", "PDY3": "1/rad^2",
        "PEY1": "-", "PEY2": "-", "PEY3": "-", "PEY4": "1/rad", "PEY5": "1/rad^2",
        "PKY1": "1/rad", "PKY2": "-", "PKY3": "1/rad", "PKY4": "-", "PKY5": "1/rad^2",
        "PKY6": "1/rad", "PKY7": "1/rad", "PHY1": "rad", "PHY2": "rad",
        "PVY1": "-", "PVY2": "-", "PVY3": "1/rad", "PVY4": "1/rad",
        "PPY1": "-", "PPY2": "-", "PPY3": "-", "PPY4": "-", "PPY5": "-",
    }
)  # fmt: skip
"""All coefficients of the pure lateral force in MF 6.1, with their units."""

ESSENTIAL = ("FNOMIN", "NOMPRES", "UNLOADED_RADIUS", "LONGVL")
PRESSURE = frozenset(name for name in COEFFICIENTS if name.startswith("PP"))
INDISPENSABLE = ("PCY1", "PDY1", "PKY1", "PKY2")
"""Coefficients without which there is no lateral force."""


@dataclass(frozen=True)
class LateralMagicFormula(TracedExpression):
    """Lateral force F_y [N] without longitudinal slip in MF 6.1 and 6.2 (4.E19-4.E30), ISO-W.

    Inputs are the slip angle alpha [rad], wheel load Fz [N], inclination gamma [rad] and, if one
    of the coefficients PPY1 to PPY5 is identified, the pressure [Pa]; otherwise the pressure is
    nominal. The equations use the angles, not alpha* and gamma*.

    The model is linear in PVY1 and PVY2. It is nonlinear in PVY3 and PVY4, because in MF 6 they
    also shift the slip angle (4.E27). Derivatives are exact; at a kink they are one-sided: if E is
    limited to 1, the derivatives by the coefficients of E are 0.

    Parameters
    ----------
    base : MagicFormula
        Tire of MF 6.1 or 6.2 with all other numbers: nominal load and pressure, ranges, scaling
        factors and fixed coefficients. Inputs outside the ranges are evaluated at their ends.
    identified : tuple of str, optional
        Coefficients that are parameters. By default all 27, which needs data over load, camber
        and pressure.
    source : Path, optional
        Property file of the base.

    Raises
    ------
    ValueError
        If the base has another version, or a coefficient is unknown or given twice.

    References
    ----------
    Pacejka, Tire and Vehicle Dynamics, 3rd ed. (2012), Sec. 4.3.2.
    """

    base: MagicFormula
    identified: tuple[str, ...] = tuple(COEFFICIENTS)
    source: Path | None = None

    output = "N"
    name = "mf61_lateral"

    def __post_init__(self) -> None:
        if self.base.parameters.version == "5.2":
            raise ValueError("base is a tire of MF 5.2; expected MF 6.1 or 6.2")
        for name in self.identified:
            if name not in COEFFICIENTS or self.identified.count(name) > 1:
                raise ValueError(
                    f"identified has {name!r}, which is unknown or given twice; "
                    f"choose from {', '.join(COEFFICIENTS)}"
                )
        if not self.identified:
            raise ValueError("identified is empty; name at least one coefficient")

    @property
    def inputs(self) -> Mapping[str, str]:
        """The input columns with their units."""
        pressure = {"pressure": "Pa"} if PRESSURE & set(self.identified) else {}
        return {"alpha": "rad", "Fz": "N", "gamma": "rad"} | pressure

    @property
    def parameters(self) -> Mapping[str, str]:
        """The identified coefficients with their units."""
        return {name: COEFFICIENTS[name] for name in self.identified}

    @property
    def linear(self) -> tuple[str, ...]:
        """The identified coefficients in which the force is linear."""
        return self.jointly_linear

    @cached_property
    def graph(self) -> Symbol:
        """Graph of the force."""
        return trace(self._force)

    def _force(self) -> Any:
        known = vars(self.base.parameters)
        p = SimpleNamespace(**known | dict(zip(self.identified, self.arguments, strict=True)))
        zero = constant(0.0)
        usual = {"kappa": zero, "Vx": constant(p.LONGVL), "pressure": constant(p.NOMPRES)}
        at = usual | dict(zip(self.inputs, self.columns, strict=True))
        c = self.base.conditions(**cast(Any, at))
        return c.loaded * self.base.pure_lateral(c, c.gamma, p).Fy

    @property
    def nominal(self) -> Mapping[str, tuple[str, float]]:
        """Nominal load [N] and pressure [Pa] of the coefficients."""
        p = self.base.parameters
        references = {"Fz": ("FNOMIN", p.LFZO * p.FNOMIN), "pressure": ("NOMPRES", p.NOMPRES)}
        return {name: references[name] for name in self.inputs if name in references}

    def derived_quantities(self, columns: Mapping[str, Array]) -> tuple[Derived, ...]:
        """Return cornering stiffness, peaks and friction."""
        return tire_features(self, columns)

    def with_coefficients(self, theta: Array) -> MagicFormula:
        """Return the base tire with identified coefficients (d,), for example for `write_tir`."""
        values = dict(zip(self.identified, np.asarray(theta, dtype=float).tolist(), strict=True))
        return replace(self.base, parameters=replace(self.base.parameters, **values))


def mf61_lateral(base: str | Mapping[str, float], identified: Sequence[str] | None = None) -> Model:
    """Make a `LateralMagicFormula` from a .tir file or from numbers.

    Parameters
    ----------
    base : str or Mapping[str, float]
        Path of a .tir file of MF 6.1 or 6.2; or numbers in SI units, by their names in property
        files. Numbers must include FNOMIN, NOMPRES, UNLOADED_RADIUS and LONGVL. Missing
        coefficients remove their terms (0; 1 for PKY2 and 2 for PKY4), so the tire has no
        longitudinal force and no aligning moment.
    identified : sequence of str, optional
        Coefficients that are parameters, by default all 27.

    Returns
    -------
    Model
        A `LateralMagicFormula`.

    Raises
    ------
    ValueError
        If a number is missing, unknown or invalid.
    """
    names = tuple(COEFFICIENTS) if identified is None else tuple(identified)
    if isinstance(base, str):
        return LateralMagicFormula(load_tir(base), names, Path(base))
    allowed, numbers = parameter_names("6.1"), dict(base)
    for name in (*ESSENTIAL, *(name for name in INDISPENSABLE if name not in names)):
        if name not in numbers:
            raise ValueError(f"base lacks {name}; give its value, or the path of a .tir file")
    for name, value in numbers.items():
        if name not in allowed or not is_number(value):
            raise ValueError(
                f"base has {name}: {value!r}; expected a parameter of MF 6.1 and its number"
            )
    absent = dict.fromkeys(required_names("6.1"), 0.0) | {"PKY2": 1.0, "PKY4": 2.0}
    values = {**CONSTANTS["6.1"], **absent, **{name: float(numbers[name]) for name in numbers}}
    return LateralMagicFormula(MagicFormula(MagicFormulaParameters(version="6.1", **values)), names)
