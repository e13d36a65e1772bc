"""Lateral force of the full Magic Formula as a model with identified coefficients."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType, SimpleNamespace

import numpy as np

from miho.models.derived import Derived
from miho.models.model import Model
from miho.quantities import Array
from miho.vehicle.models.features import tire_features
from miho.vehicle.models.magic_formula import Conditions, MagicFormula
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
class LateralMagicFormula(Model):
    """Lateral force F_y [N] without longitudinal slip in MF 6.1 and 6.2 (4.E19-4.E30), ISO-W.

    Inputs are the slip angle alpha [rad], wheel load Fz [N], inclination gamma [rad] and, if one
    of the coefficients PPY1 to PPY5 is identified, the pressure [Pa]; otherwise the pressure is
    nominal. The equations use the angles, not alpha* and gamma*.

    The model is linear in PVY1 and PVY2. It is nonlinear in PVY3 and PVY4, because in MF 6 they
    also shift the slip angle (4.E27).

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
        return tuple(name for name in self.identified if name in ("PVY1", "PVY2"))

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

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Lateral force [N], (n, N)."""
        c = self._conditions(*inputs)
        p = self._coefficients(thetas.T[:, :, None])
        return np.asarray(c.loaded * self.base.pure_lateral(c, c.gamma, p).Fy)

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the lateral force with respect to the identified coefficients, (N, d).

        If E is limited to 1, the derivatives by the coefficients of E are 0.
        """
        c = self._conditions(*inputs)
        p = self._coefficients(theta)
        y = self.base.pure_lateral(c, c.gamma, p)

        # Chain rule: derivatives of the force with respect to C, D, E, ...
        # Fy = D sin(C arctan(w)) + SV with w = z - E (z - arctan(z)) and z = K alpha_y / (C D)
        CD = y.C * y.D + self.base.epsilon
        z = y.B * y.alpha_y
        bend = z - np.arctan(z)
        w = z - y.E * bend
        angle = np.arctan(w)
        wave = y.D * np.cos(y.C * angle)
        slope = wave * y.C / (1 + w * w)
        by_z = slope * (1 - y.E * z * z / (1 + z * z))
        by_SH = by_z * y.B
        camber_shift = y.SH - (p.PHY1 + p.PHY2 * c.dfz) * p.LHY  # (K_gamma gamma - SV_gamma) / K'
        held = y.E == 1.0 if self.base.clamp_curvature else False
        outer = {
            "C": wave * angle - by_z * z * y.D / CD,
            "D": np.sin(y.C * angle) - by_z * z * y.C / CD,
            "E": np.where(held, 0.0, -slope * bend),
            "K": by_z * y.alpha_y / CD - by_SH * camber_shift / y.K_prime,
            "SH": by_SH,
            "K_gamma gamma": by_SH / y.K_prime,
            "SV": np.ones_like(z),
            "SV_gamma": 1 - by_SH / y.K_prime,
        }
        # ... times their derivatives with respect to the coefficients.
        J = np.empty((c.Fz.size, len(self.identified)))
        for quantity, inner in self._derivatives(c, p, np.sign(y.alpha_y)).items():
            for name in inner.keys() & set(self.identified):
                J[:, self.identified.index(name)] = c.loaded * outer[quantity] * inner[name]
        return J

    def _derivatives(
        self, c: Conditions, p: SimpleNamespace, side: Array
    ) -> dict[str, dict[str, Array | float]]:
        """Return the derivatives of C, D, E, K, ... with respect to their coefficients.

        `side` is the sign of the slip angle alpha_y.
        """
        dfz, dpi, size, square = c.dfz, c.dpi, np.abs(c.gamma), c.gamma**2
        nominal = p.LFZO * p.FNOMIN

        # Factors of each quantity; the derivative by a coefficient is a product of other factors.

        mu, inflated = p.PDY1 + p.PDY2 * dfz, 1 + p.PPY3 * dpi + p.PPY4 * dpi**2  # 4.E23
        grip = c.Fz * c.mu_y
        friction = grip * (1 - p.PDY3 * square)

        E = (p.PEY1 + p.PEY2 * dfz) * p.LEY  # 4.E24
        around = (1 + p.PEY5 * square - (p.PEY3 + p.PEY4 * c.gamma) * side) * p.LEY

        upright, stiffened = 1 - p.PKY3 * size, 1 + p.PPY1 * dpi  # 4.E25
        unit, relative = nominal * (1 + p.PPY2 * dpi), p.PKY2 + p.PKY5 * square
        angle = np.arctan(c.Fz / (relative * unit))
        sine = nominal * p.LKY * np.sin(p.PKY4 * angle)
        cosine = nominal * p.LKY * np.cos(p.PKY4 * angle) * p.PKY1 * upright * stiffened
        by_load = -cosine * p.PKY4 * c.Fz / ((relative * unit) ** 2 + c.Fz**2)

        camber = c.Fz * c.gamma * p.LKYC  # 4.E30, 4.E28
        thrust, faded = camber * (1 + p.PPY5 * dpi), self.base.faded(c.mu_y)
        return {
            "C": {"PCY1": p.LCY},
            "D": {
                "PDY1": friction * inflated,
                "PDY2": friction * inflated * dfz,
                "PDY3": -grip * square * mu * inflated,
                "PPY3": friction * mu * dpi,
                "PPY4": friction * mu * dpi**2,
            },
            "E": {
                "PEY1": around,
                "PEY2": around * dfz,
                "PEY3": -E * side,
                "PEY4": -E * side * c.gamma,
                "PEY5": E * square,
            },
            "K": {
                "PKY1": sine * upright * stiffened,
                "PKY2": by_load * unit,
                "PKY3": -sine * p.PKY1 * size * stiffened,
                "PKY4": cosine * angle,
                "PKY5": by_load * unit * square,
                "PPY1": sine * p.PKY1 * upright * dpi,
                "PPY2": by_load * nominal * relative * dpi,
            },
            "SH": {"PHY1": p.LHY, "PHY2": p.LHY * dfz},
            "K_gamma gamma": {
                "PKY6": thrust,
                "PKY7": thrust * dfz,
                "PPY5": camber * (p.PKY6 + p.PKY7 * dfz) * dpi,
            },
            "SV": {"PVY1": c.Fz * p.LVY * faded, "PVY2": c.Fz * p.LVY * faded * dfz},
            "SV_gamma": {"PVY3": camber * faded, "PVY4": camber * faded * dfz},
        }

    def _conditions(self, *inputs: Array) -> Conditions:
        """Return the conditions without longitudinal slip; the default pressure is nominal."""
        alpha, Fz, gamma, *pressures = inputs
        pressure = pressures[0] if pressures else np.full_like(alpha, self.base.parameters.NOMPRES)
        speed = np.full_like(alpha, self.base.parameters.LONGVL)
        return self.base.conditions(Fz, np.zeros_like(alpha), alpha, gamma, speed, pressure)

    def _coefficients(self, values: Array) -> SimpleNamespace:
        """Return all parameters, with values (d, ...) of the identified ones."""
        identified = dict(zip(self.identified, values, strict=True))
        return SimpleNamespace(**(vars(self.base.parameters) | identified))


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
        if name not in allowed or isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(
                f"base has {name}: {value!r}; expected a parameter of MF 6.1 and its number"
            )
    absent = dict.fromkeys(required_names("6.1"), 0.0) | {"PKY2": 1.0, "PKY4": 2.0}
    values = {**CONSTANTS["6.1"], **absent, **{name: float(numbers[name]) for name in numbers}}
    return LateralMagicFormula(MagicFormula(MagicFormulaParameters(version="6.1", **values)), names)
