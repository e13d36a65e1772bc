"""DFO-LS: least squares without derivatives."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from miho.methods.least_squares import MultiStart
from miho.methods.unit_box import UnitBox, global_generator
from miho.optim import Oracle, UnusableValueError
from miho.quantities import Array
from miho.validate import positive, whole

try:
    import dfols
except ModuleNotFoundError as error:
    raise ImportError(
        f"dfo_ls needs a library that is missing ({error.name}); pip install 'miho[rivals]'"
    ) from error


LEVEL = 1e4
"""Norm of a descent's first residuals, which makes the library's absolute tolerance relative."""
LIBRARY_FAILS = "H must be symmetric"
"""Message of the library's failing assertion on linear residuals; it ends a descent, not the
run."""


@dataclass(frozen=True)
class DFOLS(MultiStart):
    """DFO-LS (Cartis, Fiala, Marteau and Roberts, 2019), by the authors' library.

    A trust-region method with a linear model of the residuals that interpolates d + 1 points, in
    the unit cube. Rounds of screening and starting points are as in `LeastSquares`. A descent also
    ends when it is slow. A configuration without usable residuals counts as twice the worst
    residuals of the descent. The library's restarts, which are for noise, are off. Requires a
    least-squares problem, but no derivatives. Its algebra is in Python: a millisecond per
    evaluation.

    Parameters
    ----------
    screen, starts, rounds
        See `LeastSquares`.
    radius : float
        Initial radius of the trust region, relative to the range.
    smallest : float
        A descent ends at this radius.
    evaluations : int
        Most evaluations of a descent, times d + 1.
    most : int
        Most evaluations of a descent.

    Raises
    ------
    ValueError
        If a setting is out of its range.

    References
    ----------
    C. Cartis, J. Fiala, B. Marteau and L. Roberts, ACM Trans. Math. Softw. 45, 2019.
    """

    screen: int = 10
    starts: int = 1
    rounds: int | None = None
    radius: float = 0.1
    smallest: float = 1e-8
    evaluations: int = 100
    most: int = 1000

    def __post_init__(self) -> None:
        self.check_starts()
        positive("smallest", self.smallest)
        if not self.smallest < self.radius <= 0.5:
            raise ValueError(f"radius is {self.radius!r}; expected above smallest, at most 0.5")
        whole("evaluations", self.evaluations, 1)
        whole("most", self.most, 1)

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Screen and descend, `rounds` times."""
        box = UnitBox(oracle.space)
        d = len(oracle.space)

        def solve(theta: Array) -> bool:
            with warnings.catch_warnings(action="ignore"), global_generator(rng):
                try:
                    solution = dfols.solve(
                        _ScaledResiduals(oracle, box),
                        box.x(theta),
                        bounds=(np.zeros(d), np.ones(d)),
                        rhobeg=self.radius,
                        rhoend=self.smallest,
                        maxfun=min(self.evaluations * (d + 1), self.most),
                        do_logging=False,
                    )
                except AssertionError as error:
                    if str(error) != LIBRARY_FAILS:
                        raise
                    return False
            return bool(solution.flag == solution.EXIT_SUCCESS)

        self.descend_from_best(oracle, rng, solve)


class _ScaledResiduals:
    """Scaled residuals (m,) over the unit cube; finite if they are usable at the start."""

    def __init__(self, oracle: Oracle, box: UnitBox) -> None:
        self._oracle = oracle
        self._box = box
        self._scale: float | None = None
        self._worst = np.empty(0)

    def __call__(self, x: Array) -> Array:
        try:
            residuals = self._oracle.residuals(self._box.theta(x))
            usable = bool(np.isfinite(residuals @ residuals))
        except UnusableValueError:
            usable = False
        if self._scale is None:
            if not usable:
                raise ValueError("a descent cannot start: its residuals are not usable")
            self._scale = LEVEL / (float(np.linalg.norm(residuals)) or 1.0)
        if not usable:
            return 2 * self._worst
        residuals = residuals * self._scale
        if not self._worst.size or residuals @ residuals > self._worst @ self._worst:
            self._worst = residuals
        return residuals
