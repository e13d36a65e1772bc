"""Multistart nonlinear least squares, the method that an expert would try first."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count

import numpy as np

from miho.methods.descent import METHODS, SMALLEST_TOLERANCE, descend, ending_where_unusable
from miho.optim import Optimizer, Oracle
from miho.optim.space import LARGEST_BATCH
from miho.quantities import Array
from miho.validate import at_least, one_of, whole

SCREENING = 0.2
"""Largest share of the remaining budget for a round of screening."""
TICK = 1e-6
"""Shortest measurable duration of a batch [s]."""


@dataclass(frozen=True)
class MultiStart(Optimizer):
    """Abstract base class of methods that screen configurations and descend from the best."""

    screen: int = 500
    starts: int = 10
    rounds: int | None = 3

    def check_starts(self) -> None:
        """Raise ValueError unless these settings are valid."""
        whole("screen", self.screen, 1, LARGEST_BATCH)
        whole("starts", self.starts, 1, LARGEST_BATCH)
        whole("rounds", self.rounds, 1, LARGEST_BATCH, none=True)

    def descend_from_best(
        self, oracle: Oracle, rng: np.random.Generator, solve: Callable[[Array], bool]
    ) -> None:
        """Call `solve` on the `starts` best (d,) of `screen` configurations, `rounds` times.

        If `rounds` is None, only the budget stops it. `solve` returns whether it converged; each
        call is recorded as a descent of the run. Screening a round uses at most SCREENING of the
        remaining evaluations and seconds, so that a slow model gets its descents too.
        """
        space = oracle.space
        coordinates = space.initial(self.screen)
        for _ in count() if self.rounds is None else range(self.rounds):
            thetas = space.decode(coordinates)
            losses = screening_losses(oracle, thetas)
            oracle.starts.screened += losses.size
            for i in np.argsort(losses, kind="stable")[: self.starts]:
                if not np.isfinite(losses[i]):
                    break
                with ending_where_unusable(), oracle.starts.descent() as descent:
                    descent.converged = solve(thetas[i])
            coordinates = space.sample(self.screen, rng)


@dataclass(frozen=True)
class SolverStarts(MultiStart):
    """Abstract base class of methods that descend by one of SciPy's least-squares solvers."""

    loads = ("scipy.optimize",)
    tolerance: float = 1e-10
    method: str = "trf"

    def __post_init__(self) -> None:
        self.check_starts()
        at_least("tolerance", self.tolerance, SMALLEST_TOLERANCE)
        one_of("method", self.method, METHODS)


@dataclass(frozen=True)
class LeastSquares(SolverStarts):
    """Screen random configurations, then run one of SciPy's solvers from the best.

    The first round screens the common initial configurations. Screening uses at most a fifth of the
    remaining evaluations and seconds. Requires a least-squares problem.

    Parameters
    ----------
    screen : int
        Configurations that a round screens.
    starts : int
        Number of best configurations that start the solver in each round.
    rounds : int or None
        Rounds after which the method ends as converged; None to continue until the budget ends.
    tolerance : float
        A descent stops at this relative change. It also stops after SciPy's 100 evaluations per
        parameter.
    method : {'trf', 'lm'}
        The solver: trust-region reflective, which supports bounds, or MINPACK's
        Levenberg-Marquardt, which does not and uses transformed parameters. Both are scaled by the
        Jacobian.

    Raises
    ------
    ValueError
        If a setting is out of its range.

    Examples
    --------
    >>> import numpy as np
    >>> import miho
    >>> from miho.methods import LeastSquares
    >>> def decay(t, a, b):
    ...     return a * np.exp(-b * t)
    >>> t = np.linspace(0, 2, 50)
    >>> bounds = {"a": (0, 5), "b": (0, 10)}
    >>> fit = miho.fit(decay, t, decay(t, 2, 1.5), bounds, method=LeastSquares(starts=3))
    >>> round(fit.values["b"], 4)
    1.5
    """

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Screen and solve, `rounds` times."""

        def solve(theta: Array) -> bool:
            look, slopes = oracle.residuals, oracle.jacobian
            return descend(look, slopes, theta, oracle.space, self.tolerance, self.method)

        self.descend_from_best(oracle, rng, solve)


def screening_losses(oracle: Oracle, thetas: Array) -> Array:
    """Losses of the first of `thetas` (n, d), as many as SCREENING of the budget allows.

    With a time limit they are evaluated in growing batches, because only earlier batches show the
    duration of an evaluation.
    """
    most = len(thetas)
    if math.isfinite(oracle.remaining):
        most = min(most, max(1, int(SCREENING * oracle.remaining)))
    seconds = oracle.budget.seconds
    if seconds is None:
        return oracle(thetas[:most])
    until = oracle.seconds + SCREENING * (seconds - oracle.seconds)
    losses, started = oracle(thetas[:1]), oracle.seconds
    while losses.size < most and oracle.seconds < until:
        in_time = (until - oracle.seconds) / max(oracle.seconds - started, TICK) * losses.size
        batch = int(min(losses.size, most - losses.size, max(1.0, in_time)))
        losses = np.concatenate((losses, oracle(thetas[losses.size : losses.size + batch])))
    return losses
