"""A full tire as one simple curve per load, camber and pressure, and back.

At fixed conditions the lateral force of the Magic Formula is the curve of `PacejkaCurvature`, but
for one thing: its E differs between the two sides of the curve (PEY3, PEY4; 4.E24). The simple
curve takes the mean of the two; `asymmetry` keeps the rest, and `residual` says what it is worth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy  # which loads its packages where they are used: importing them takes a second
from numpy.typing import ArrayLike

from miho.models.lateral_magic_formula import COEFFICIENTS, LateralMagicFormula
from miho.models.magic_formula import MagicFormula
from miho.models.tire import PacejkaCurvature
from miho.quantities import Array

SLIP = np.linspace(-0.3, 0.3, 61)
"""Slip angles [rad] over which curves are compared."""


class SimplifiedTire(NamedTuple):
    """A table with a row per condition; every column (rows,).

    Fz: wheel load [N]. gamma: inclination [rad]. pressure: inflation pressure [Pa]. B [1/rad],
    C [-], D [N], E [-], Sx [rad], Sy [N]: parameters of `PacejkaCurvature`, ISO-W.
    asymmetry: the tire's E is E + asymmetry where alpha > Sx and E - asymmetry where alpha < Sx.
    residual: largest difference [N] between simple curve and tire for |alpha| up to 0.3 rad.
    """

    Fz: Array
    gamma: Array
    pressure: Array
    B: Array
    C: Array
    D: Array
    E: Array
    Sx: Array
    Sy: Array
    asymmetry: Array
    residual: Array

    def force(self, alpha: ArrayLike, two_sided: bool = False) -> Array:
        """Lateral force [N] at slip angles [rad] (N,), (rows, N).

        `two_sided` gives each side its own E, as the tire has it.
        """
        slip = np.asarray(alpha, dtype=float)
        model = PacejkaCurvature()
        B, C, D, E, Sx, Sy = self[3:9]
        if not two_sided:
            return model.predict(np.stack([B, C, D, E, Sx, Sy], axis=1), slip)
        right, left = (
            model.predict(np.stack([B, C, D, E + sign * self.asymmetry, Sx, Sy], axis=1), slip)
            for sign in (1, -1)
        )
        return np.where(slip > Sx[:, None], right, left)


def simplify(
    tire: MagicFormula,
    Fz: ArrayLike,
    gamma: ArrayLike = 0.0,
    pressure: ArrayLike | None = None,
) -> SimplifiedTire:
    """The simple curves of a tire at every combination of loads, cambers and pressures.

    Fz: wheel loads above 0 [N]. gamma: inclinations [rad]. pressure: [Pa], nominal if None. The
    parameters are those of the equations (4.E20-4.E29), not fitted, at the speed LONGVL; inputs
    beyond the tire's ranges are evaluated at their edge.
    """
    p = tire.parameters
    axes = (Fz, gamma, p.NOMPRES if pressure is None else pressure)
    loads, cambers, pressures = (
        grid.ravel()
        for grid in np.meshgrid(*(np.asarray(axis, float) for axis in axes), indexing="ij")
    )
    if not (np.isfinite(loads).all() and (loads > 0).all()):
        raise ValueError(f"Fz is {loads.tolist()}; expected finite loads above 0")

    slip = _slip(tire)
    zero, speed = np.zeros_like(loads), np.full_like(loads, p.LONGVL)
    middle, *sides = (
        tire.conditions(loads, zero, zero + alpha, cambers, speed, pressures)
        for alpha in (0.0, slip[-1], slip[0])
    )
    centre, right, left = (tire.pure_lateral(c, c.gamma * p.LGAY, p) for c in (middle, *sides))
    table = SimplifiedTire(
        Fz=loads,
        gamma=cambers,
        pressure=pressures,
        B=-centre.B,
        C=np.broadcast_to(centre.C, loads.shape),
        D=middle.loaded * centre.D,
        E=(right.E + left.E) / 2,
        Sx=-centre.SH,
        Sy=middle.loaded * centre.SV,
        asymmetry=(right.E - left.E) / 2,
        residual=zero,
    )
    row = loads[:, None], cambers[:, None], pressures[:, None]
    true = tire.forces(row[0], 0.0, slip, row[1], pressure=row[2]).Fy
    return table._replace(residual=np.abs(table.force(slip) - true).max(axis=1))


def from_simplified(table: SimplifiedTire, base: MagicFormula) -> MagicFormula:
    """The tire of MF 6.1 whose lateral forces come closest to the curves of a table.

    Its lateral coefficients are found by least squares from the table alone; all else is that of
    `base`, a tire of MF 6.1 or 6.2, such as its nominal load and pressure. A coefficient on which
    the table has no bearing (of camber without camber, of pressure at one pressure) becomes 0.
    `write_tir` makes a file of the result. Raises ValueError for a table without a finite curve.
    """
    if not table.Fz.size or not all(np.isfinite(column).all() for column in table[:-1]):
        raise ValueError("the table has no rows or numbers that are not finite; leave those out")
    model = LateralMagicFormula(base)
    slip = _slip(base)
    target = table.force(slip, two_sided=True)
    inputs = (
        np.tile(slip, table.Fz.size),
        *(np.repeat(column, slip.size) for column in (table.Fz, table.gamma, table.pressure)),
    )
    # Each curve counts the same, whatever its load.
    weight = np.repeat(1 / np.abs(target).max(axis=1), slip.size)

    def misfit(theta: Array) -> Array:
        return np.asarray(weight * (model.predict(theta[None], *inputs)[0] - target.ravel()))

    def slopes(theta: Array) -> Array:
        return weight[:, None] * model.jacobian(theta, *inputs)

    solution = scipy.optimize.least_squares(
        misfit,
        _start(table, base),
        jac=slopes,
        method="lm",  # takes no step in coefficients on which nothing depends
        x_scale="jac",
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    return model.with_coefficients(solution.x)


def _slip(tire: MagicFormula) -> Array:
    """Slip angles within the tire's range, if it has one."""
    p = tire.parameters
    return np.clip(SLIP, p.ALPMIN, p.ALPMAX) if tire.clamp_inputs else SLIP


def _start(table: SimplifiedTire, base: MagicFormula) -> Array:
    """Coefficients that give the table's mean curve; all variation is left to the solver."""
    stiffness = table.B * table.C * table.D
    ratio = np.mean(table.Fz) / base.parameters.FNOMIN
    start = dict.fromkeys(COEFFICIENTS, 0.0) | {
        "PCY1": float(table.C.mean()),
        "PDY1": float(np.mean(table.D / table.Fz)),
        "PEY1": float(table.E.mean()),
        "PKY1": -float(stiffness.max()) / base.parameters.FNOMIN,
        "PKY2": 2.0 * ratio,
        "PKY4": 2.0,
        "PHY1": -float(table.Sx.mean()),
        "PVY1": float(np.mean(table.Sy / table.Fz)),
    }
    return np.array([start[name] for name in COEFFICIENTS])
