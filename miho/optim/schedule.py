"""The schedule of Hyperband: its brackets and rungs (Alg. 1, lines 1-6)."""

from __future__ import annotations

from dataclasses import dataclass

from miho.validate import one_of, whole

ROUNDINGS = ("ceil", "floor")


@dataclass(frozen=True)
class Rung:
    """A rung of Hyperband (Alg. 1).

    Attributes
    ----------
    s : int
        Bracket, from s_max down to 0.
    j : int
        Position of the rung in the bracket, from 0 to s.
    n : int
        Number of configurations.
    mutations : int
        Mutations of each configuration on the rung, one evaluation each.
    """

    s: int
    j: int
    n: int
    mutations: int


def largest_bracket(R: int, eta: int, rounding: str = "ceil") -> int:
    """s_max of line 1: log_eta(R), rounded up as printed, or down as in the original Hyperband.

    In integers: floating-point logarithms lose a bracket at (243, 3) and (1000, 10).
    """
    s, power = 0, 1
    while power * eta <= R:
        s, power = s + 1, power * eta
    return s + (rounding == "ceil" and power < R)


def hyperband_table(R: int, eta: int, rounding: str = "ceil") -> tuple[Rung, ...]:
    """Return all rungs in the order of Alg. 1: brackets s = s_max ... 0, rungs j = 0 ... s.

    With B = (s_max + 1) R, bracket s starts with n = ceil(B / R * eta^s / (s + 1)) configurations;
    rung j has floor(n / eta^j), at least one, with floor(R eta^(j - s)) mutations each.

    Parameters
    ----------
    R : int
        Largest number of mutations of one configuration on a rung.
    eta : int
        One configuration in `eta` continues on the next rung (η).
    rounding : {"ceil", "floor"}, optional
        Rounding of s_max = log_eta(R); "ceil" is as printed, "floor" as in the original Hyperband.

    Returns
    -------
    tuple of Rung
        The rungs.

    Raises
    ------
    ValueError
        If `R` is below 1, `eta` is below 2, or `rounding` is unknown.

    References
    ----------
    L. Li et al., "Hyperband: a novel bandit-based approach to hyperparameter optimization", JMLR
    18, 2018.

    Examples
    --------
    >>> from miho.optim import hyperband_table
    >>> [(rung.s, rung.n, rung.mutations) for rung in hyperband_table(9, 3)]
    [(2, 9, 1), (2, 3, 3), (2, 1, 9), (1, 5, 3), (1, 1, 9), (0, 3, 9)]
    """
    whole("R", R, 1)
    whole("eta", eta, 2)
    one_of("rounding", rounding, ROUNDINGS)
    s_max = largest_bracket(R, eta, rounding)
    rungs = []
    for s in range(s_max, -1, -1):
        n = -(-(s_max + 1) * eta**s // (s + 1))
        rungs += [Rung(s, j, max(1, n // eta**j), R * eta**j // eta**s) for j in range(s + 1)]
    return tuple(rungs)
