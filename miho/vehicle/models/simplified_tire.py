"""Conversion between a full tire and simple curves for each load, camber and pressure.

At fixed conditions, the lateral force of the Magic Formula is the curve of `PacejkaCurvature`, with
one exception: E differs between the two sides of the curve (PEY3, PEY4; 4.E24). The simple curve
uses the mean of both values. `asymmetry` is the deviation, and `residual` is its effect.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy  # loads its subpackages at first use, because importing them takes a second
from numpy.typing import ArrayLike

from miho.quantities import Array
from miho.vehicle.models.lateral_magic_formula import COEFFICIENTS, LateralMagicFormula
from miho.vehicle.models.magic_formula import MagicFormula
from miho.vehicle.models.tire import PacejkaCurvature

SLIP = np.linspace(-0.3, 0.3, 61)
"""Slip angles [rad] over which curves are compared."""


class SimplifiedTire(NamedTuple):
    """Table of simple curves with one row per condition.

    Attributes
    ----------
    Fz, gamma, pressure : ndarray of shape (rows,)
        Wheel load [N], inclination [rad] and inflation pressure [Pa].
    B, C, D, E, Sx, Sy : ndarray of shape (rows,)
        Parameters of `PacejkaCurvature` [1/rad, -, N, -, rad, N], ISO-W.
    asymmetry : ndarray of shape (rows,)
        The tire has E + asymmetry for alpha > Sx, and E - asymmetry for alpha < Sx [-].
    residual : ndarray of shape (rows,)
        Largest difference between simple curve and tire for |alpha| up to 0.3 rad [N].
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
        """Return the lateral force [N], (rows, N), at slip angles [rad], (N,).

        With `two_sided`, the two sides of the curve have different E, as in the tire.
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
    tire: MagicFormula, Fz: ArrayLike, gamma: ArrayLike = 0.0, pressure: ArrayLike | None = None
) -> SimplifiedTire:
    """Return the simple curves of a tire at all combinations of loads, cambers and pressures.

    The parameters follow from the equations (4.E20-4.E29) at the speed LONGVL, without a fit.
    Inputs outside the ranges of the tire are evaluated at the ends of the ranges.

    Parameters
    ----------
    tire : MagicFormula
        The full tire.
    Fz : array_like
        Wheel loads [N], above 0.
    gamma : array_like, optional
        Inclinations [rad].
    pressure : array_like, optional
        Inflation pressures [Pa], by default nominal.

    Returns
    -------
    SimplifiedTire
        Table with one row per combination.

    Raises
    ------
    ValueError
        If a load is not positive and finite.
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
    """Fit the lateral coefficients of a full tire to a table of simple curves.

    Coefficients are the least-squares solution for the table. Coefficients that the table does not
    determine become 0, for example camber terms without camber.

    Parameters
    ----------
    table : SimplifiedTire
        The simple curves.
    base : MagicFormula
        Tire of MF 6.1 or 6.2 with all other numbers, for example nominal load and pressure.

    Returns
    -------
    MagicFormula
        The fitted tire; `write_tir` writes it to a file.

    Raises
    ------
    ValueError
        If the table has no rows or has numbers that are not finite.
    """
    if not table.Fz.size or not all(np.isfinite(column).all() for column in table[:-1]):
        raise ValueError(
            "the table is empty or has numbers that are not finite; expected at least one row of "
            "finite numbers"
        )
    model = LateralMagicFormula(base)
    slip = _slip(base)
    target = table.force(slip, two_sided=True)
    inputs = (
        np.tile(slip, table.Fz.size),
        *(np.repeat(column, slip.size) for column in (table.Fz, table.gamma, table.pressure)),
    )
    # All curves have equal weight, independent of the load.
    weight = np.repeat(1 / np.abs(target).max(axis=1), slip.size)

    def misfit(theta: Array) -> Array:
        return np.asarray(weight * (model.predict(theta[None], *inputs)[0] - target.ravel()))

    def slopes(theta: Array) -> Array:
        return weight[:, None] * model.jacobian(theta, *inputs)

    solution = scipy.optimize.least_squares(
        misfit,
        _start(table, base),
        jac=slopes,
        method="lm",  # leaves undetermined coefficients at 0
        x_scale="jac",
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    return model.with_coefficients(solution.x)


def _slip(tire: MagicFormula) -> Array:
    """Return slip angles within the range of the tire."""
    p = tire.parameters
    return np.clip(SLIP, p.ALPMIN, p.ALPMAX) if tire.clamp_inputs else SLIP


def _start(table: SimplifiedTire, base: MagicFormula) -> Array:
    """Return coefficients of the mean curve of the table, as a start of the solver."""
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
