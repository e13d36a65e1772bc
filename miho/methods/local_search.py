"""Multistart local search that needs only the loss, or the loss and its gradient."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy  # loads its subpackages on first use: importing them takes a second

from miho.methods.least_squares import MultiStart
from miho.methods.unit_box import UnitBox
from miho.optim import Oracle
from miho.optim.problem import mean_square
from miho.quantities import Array
from miho.validate import positive, whole, whole_settings

Slope = Callable[[Array], tuple[float, Array]]

LARGE = 1e12
"""Scaled loss at the start of a descent."""
STEP = math.sqrt(np.finfo(float).eps)
"""Forward difference, relative to the range, that balances truncation and rounding."""


@dataclass(frozen=True)
class LBFGSB(MultiStart):
    """Multistart L-BFGS-B (Byrd, Lu, Nocedal and Zhu, 1995) in the unit cube.

    Rounds of screening and starting points are as in `LeastSquares`. A least-squares problem
    provides the gradient 2/N J^T r at the cost of its Jacobian; other problems are differenced, at
    d evaluations per gradient. A configuration without a finite loss counts as twice the worst loss
    of the descent, with zero gradient, so that the line search turns back.

    Parameters
    ----------
    screen, starts, rounds
        See `LeastSquares`.
    tolerance : float
        A descent ends when a step gains less than this share of the loss. The loss is scaled up for
        that, because SciPy's criterion is absolute for losses below one.
    memory : int
        Number of stored corrections.
    line_search : int
        Most evaluations of a line search.
    iterations : int
        Most iterations and evaluations of a descent.

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """

    loads = ("scipy.optimize",)
    rounds: int | None = None
    tolerance: float = 1e-10
    memory: int = 10
    line_search: int = 20
    iterations: int = 15_000

    def __post_init__(self) -> None:
        self.check_starts()
        positive("tolerance", self.tolerance)
        whole_settings(self, ("memory", "line_search", "iterations"), 1)

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Screen and descend, `rounds` times."""
        box = UnitBox(oracle.space)
        slope = _analytic(oracle, box) if _has_residuals(oracle) else _differenced(oracle, box)

        def solve(theta: Array) -> bool:
            solution = scipy.optimize.minimize(
                _ScaledLoss(slope),
                box.x(theta),
                jac=True,
                method="L-BFGS-B",
                bounds=[(0.0, 1.0)] * len(oracle.space),
                options={
                    "maxcor": self.memory,
                    "ftol": self.tolerance,
                    "gtol": 0.0,  # an absolute tolerance, but the unit of the loss is unknown
                    "maxiter": self.iterations,
                    "maxfun": self.iterations,
                    "maxls": self.line_search,
                },
            )
            return bool(solution.success)

        self.descend_from_best(oracle, rng, solve)


@dataclass(frozen=True)
class NelderMead(MultiStart):
    """Multistart Nelder-Mead with coefficients that depend on the dimension (Gao and Han, 2012).

    Rounds of screening and starting points are as in `LeastSquares`; the search is SciPy's, in the
    unit cube. Only comparisons matter: the method needs no derivatives and accepts infinite losses,
    but it is slow beyond about ten parameters and may stop at points that are not optimal.

    Parameters
    ----------
    screen, starts, rounds
        See `LeastSquares`.
    tolerance : float
        A descent ends when the simplex is smaller than this share of the range.
    edge : float
        Edges of the first simplex as a share of the range; they point inwards at an upper bound.
    evaluations : int
        Most evaluations of a descent, per parameter.

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """

    loads = ("scipy.optimize",)
    rounds: int | None = None
    tolerance: float = 1e-8
    edge: float = 0.05
    evaluations: int = 1000

    def __post_init__(self) -> None:
        self.check_starts()
        positive("tolerance", self.tolerance)
        positive("edge", self.edge)
        if self.edge > 0.5:
            raise ValueError(f"edge is {self.edge!r}; expected at most half of the range, 0.5")
        whole("evaluations", self.evaluations, 1)

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Screen and descend, `rounds` times."""
        box = UnitBox(oracle.space)
        d = len(oracle.space)

        def loss(x: Array) -> float:
            return float(oracle(box.theta(x)[None])[0])

        def solve(theta: Array) -> bool:
            x = box.x(theta)
            inwards = np.where(x + self.edge > 1, -self.edge, self.edge)
            solution = scipy.optimize.minimize(
                loss,
                x,
                method="Nelder-Mead",
                bounds=[(0.0, 1.0)] * d,
                options={
                    "adaptive": True,
                    "initial_simplex": np.vstack([x, x + np.diag(inwards)]),
                    "xatol": self.tolerance,
                    "fatol": math.inf,  # an absolute tolerance, but the unit is unknown
                    "maxfev": self.evaluations * d,
                    "maxiter": self.evaluations * d,
                },
            )
            return bool(solution.success)

        self.descend_from_best(oracle, rng, solve)


class _ScaledLoss:
    """Loss and gradient for one descent, scaled to LARGE at its start and finite everywhere."""

    def __init__(self, slope: Slope) -> None:
        self._slope = slope
        self._scale: float | None = None
        self._worst = -math.inf

    def __call__(self, x: Array) -> tuple[float, Array]:
        loss, gradient = self._slope(x)
        usable = math.isfinite(loss) and bool(np.isfinite(gradient).all())
        if self._scale is None:
            if not usable:
                raise ValueError("a descent cannot start: its loss or gradient is not finite")
            self._scale = LARGE / abs(loss) if loss != 0 else 1.0
        if not usable:
            return self._worst + abs(self._worst), np.zeros_like(x)
        loss *= self._scale
        self._worst = max(self._worst, loss)
        return loss, gradient * self._scale


def _has_residuals(oracle: Oracle) -> bool:
    try:
        return oracle.traits.linear is not None
    except TypeError:
        return False


def _analytic(oracle: Oracle, box: UnitBox) -> Slope:
    def slope(x: Array) -> tuple[float, Array]:
        theta = box.theta(x)
        residuals = oracle.residuals(theta)
        loss = float(mean_square(residuals))
        if not math.isfinite(loss):
            return math.inf, np.zeros_like(x)
        gradient = 2 / residuals.size * (oracle.jacobian(theta).T @ residuals)
        return loss, gradient * box.slope(theta)

    return slope


def _differenced(oracle: Oracle, box: UnitBox) -> Slope:
    def slope(x: Array) -> tuple[float, Array]:
        steps = np.where(x + STEP > 1, -STEP, STEP)
        losses = oracle(box.theta(np.vstack([x, x + np.diag(steps)])))
        if not math.isfinite(losses[0]):
            return math.inf, np.zeros_like(x)
        return float(losses[0]), (losses[1:] - losses[0]) / steps

    return slope
