"""Sign conventions of tire measurements, and their conversion to ISO-W.

All conventions share the x axis, which points forward, and with it Fx, kappa, Mx and gamma, a
rotation about x (positive when the top of the wheel leans to the right). They differ in y and z:

    iso-w        y to the left, z up. A velocity to the left is a positive slip angle, and the
                 force falls as the slip angle grows. Used by this project, MF-Tyre and Adams.
    sae          SAE J670e: y to the right, z down, with the same definitions in these axes, so
                 that alpha, Fy, Fz, My and Mz have the opposite sign. Used by the Tire Test
                 Consortium.
    adapted-sae  The axes of SAE, but alpha and Fz are defined so that both are positive with a
                 positive Fy: only Fy, My and Mz have the opposite sign. Used by Pacejka's book.

References
----------
H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, App. 1.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from miho.quantities import Array

FLIPPED: Mapping[str, frozenset[str]] = MappingProxyType(
    {
        "iso-w": frozenset(),
        "sae": frozenset({"alpha", "Fy", "Fz", "My", "Mz"}),
        "adapted-sae": frozenset({"Fy", "My", "Mz"}),
    }
)
"""For each convention, the columns whose sign differs from ISO-W."""

CLEAR = 0.5
"""Smallest rank correlation of a column that clearly rises with another."""
EVIDENT = 5.0
"""Smallest rank correlation by Fisher's transform, in standard errors. Columns of 8 to 10
independent numbers exceed it with a probability of at most 3e-5, longer ones with a smaller one."""
SMALL_SLIP: Mapping[str, float] = MappingProxyType({"alpha": 0.07, "kappa": 0.02})
"""Largest slip at which the aligning moment has the sign of alpha: alpha [rad], kappa [1]."""
FEWEST = 8
"""Smallest number of rows for a check of signs."""


class Law(NamedTuple):
    """A force grows with a slip (sign 1) or falls (-1), while columns are at most `largest`.

    The law is checked only if the slip varies by more than `least_range` or has both signs;
    otherwise it may be an offset.
    """

    slip: str
    slip_unit: str
    force: str
    unit: str
    sign: int
    largest: Mapping[str, float]
    least_range: float = 0.0


class SignProblem(NamedTuple):
    """A column that cannot be in ISO-W signs, the problem in words, and columns to negate.

    To negate one of `negated` resolves the problem.
    """

    column: str
    problem: str
    negated: tuple[str, ...]


LAWS = (
    Law("alpha", "rad", "Fy", "N", -1, {}),
    Law("kappa", "-", "Fx", "N", 1, {"alpha": SMALL_SLIP["alpha"]}, least_range=0.03),
    Law("alpha", "rad", "Mz", "Nm", 1, SMALL_SLIP),
)
"""Signs of a tire's response to slip, in ISO-W."""


def to_iso_w(
    columns: Mapping[str, Array], convention: str, flip: Collection[str] = ()
) -> dict[str, Array]:
    """Convert columns (N,) to ISO-W signs; columns named in `flip` change their sign once more."""
    signs = {key: (key in FLIPPED[convention]) != (key in flip) for key in columns}
    return {key: -column if signs[key] else column for key, column in columns.items()}


def sign_problem(
    columns: Mapping[str, Array], units: Mapping[str, str], clear: float = CLEAR
) -> SignProblem | None:
    """Return the first column that cannot be in ISO-W signs, or None.

    Fz is the load on the road. A tire pushes against its slip angle and turns the wheel back: Fy
    falls as alpha grows, Mz rises with alpha as long as the slip is small, and Fx rises with kappa
    if alpha is small. An opposite rank correlation above `clear` counts as a problem, if noise
    alone cannot cause it.
    """
    if units.get("Fz") == "N" and np.median(columns["Fz"]) < 0:
        return SignProblem("Fz", "Fz is mostly negative, but it is positive in ISO-W", ("Fz",))
    for law in LAWS:
        if (units.get(law.slip), units.get(law.force)) == (law.slip_unit, law.unit):
            rows = np.ones(columns[law.slip].size, dtype=bool)
            for name in law.largest.keys() & columns.keys():
                rows &= np.abs(columns[name]) <= law.largest[name]
            x, y = columns[law.slip][rows], -law.sign * columns[law.force][rows]
            if x.size < FEWEST or not (np.ptp(x) > law.least_range or x.min() < 0 < x.max()):
                continue
            if _rank_correlation(x, y) > _largest_by_noise(x.size, clear) and x @ y > 0:
                does, should = ("falls", "rises") if law.sign > 0 else ("rises", "falls")
                problem = f"{law.force} {does} with {law.slip}, but it {should} in ISO-W"
                return SignProblem(law.force, problem, (law.slip, law.force))
    return None


def conventions_of(
    columns: Mapping[str, Array], units: Mapping[str, str], convention: str
) -> list[str]:
    """Return the conventions without a sign problem, for columns (N,) converted from another."""
    raw = to_iso_w(columns, convention)  # each sign is its own inverse
    return [name for name in FLIPPED if sign_problem(to_iso_w(raw, name), units) is None]


def _largest_by_noise(rows: int, clear: float) -> float:
    """Largest rank correlation of independent columns, and at least `clear`.

    Its variance by Fisher's transform is 1.06 / (rows - 3) (Fieller, Hartley and Pearson,
    Biometrika 44 (1957) 470-481).
    """
    return max(clear, float(np.tanh(EVIDENT * np.sqrt(1.06 / (rows - 3)))))


def _rank_correlation(x: Array, y: Array) -> float:
    """Spearman's rank correlation, with ties ranked in row order; 0 if a column is constant."""
    if np.ptp(x) == 0 or np.ptp(y) == 0:
        return 0.0
    a, b = (np.argsort(np.argsort(column, kind="stable")) for column in (x, y))
    n = float(x.size)
    return 1 - 6 * float(((a - b) ** 2).sum()) / (n * (n * n - 1))
