"""Budget, evaluation counts and best loss of a run, and the exceptions that end it."""

from __future__ import annotations

import math
import re
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from miho.optim.trace import Starts, Trace
from miho.quantities import Array
from miho.validate import is_finite, positive, whole

REASONS = 20
"""Largest number of reasons for rejected values that are counted separately."""
FIRST = "; first at "
"""Separator of the reason for a rejected value and its first configuration."""
NUMBER = re.compile(
    r"(?<!\.py:)(?<!\w)(?:0x[0-9a-f]+|[-+]?(?:\d[\d_]*(?:\.\d*)*|\.\d+)(?:[eE][-+]?\d+)?)"
)
"""A number in a reason; not part of a name, for example x1, and not a line number."""


class BudgetExhausted(Exception):  # noqa: N818 -- the signal that ends every run, not an error
    """Raised by the oracle when its budget is used up or its target is reached."""


class RunInterrupted(KeyboardInterrupt):
    """Raised by the oracle between two evaluations after Ctrl-C, where the state can be resumed."""


class UnusableValueError(ValueError):
    """Raised by the oracle if residuals or derivatives cannot be computed."""


@dataclass(frozen=True)
class Budget:
    """Limits of one run; None means no limit.

    Parameters
    ----------
    evaluations : int, optional
        Largest number of full evaluations, which is never exceeded.
    seconds : float, optional
        Longest time on the clock of the method, in seconds; checked about every 20 ms.
    target : float, optional
        A run ends when its loss is at most this.

    Raises
    ------
    ValueError
        If a limit is not positive, or the target is not finite.

    Examples
    --------
    >>> import miho
    >>> miho.Budget(evaluations=1000, seconds=60)
    Budget(evaluations=1000, seconds=60, target=None)
    """

    evaluations: int | None = None
    seconds: float | None = None
    target: float | None = None

    def __post_init__(self) -> None:
        if self.evaluations is not None:
            whole("budget.evaluations", self.evaluations, 1)
        if self.seconds is not None:
            positive("budget.seconds", self.seconds)
        if self.target is not None and not is_finite(self.target):
            raise ValueError(f"budget.target is {self.target!r}; expected a finite loss")


class Provisional(NamedTuple):
    """Best configuration `theta` (d,) of a run that has evaluated none on all rows of the data.

    `cost` is the share of the rows that were used, in evaluations, and `loss` the loss over them.
    More rows are better than fewer, whatever the loss.
    """

    cost: float
    loss: float
    theta: Array


@dataclass
class Meter:
    """Counts and results of a run; with the state of the method, all that a resumed run needs.

    Attributes
    ----------
    evaluations : float
        Full evaluations so far.
    seconds, cpu_seconds : float
        Wall and CPU time of the method.
    best : float
        Best loss; math.inf if no loss was finite.
    trace : Trace
        Improvements of the best loss.
    rejected : Counter
        Unusable values by reason.
    unfinished : list of float
        Losses of an interrupted batch; a second evaluation of the batch continues after them.
    outside : int
        Configurations outside the bounds of the space. Their values are used, but a method should
        not propose them.
    starts : Starts
        Starts and descents of the run.
    at_a_time : int
        Simultaneous evaluations of an asynchronous method.
    provisional : Provisional or None
        Best configuration on fewer rows, until one is evaluated on all rows.
    """

    evaluations: float = 0
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    best: float = math.inf
    trace: Trace = field(default_factory=Trace)
    rejected: Counter[str] = field(default_factory=Counter)
    unfinished: list[float] = field(default_factory=list)
    outside: int = 0
    starts: Starts = field(default_factory=Starts)
    at_a_time: int = 1
    provisional: Provisional | None = None

    def note(self, cost: float, losses: Array, thetas: Array) -> None:
        """Record the best of some configurations (n, d), unless one is known on as many rows."""
        k = int(np.argmin(losses))
        best, loss = self.provisional, float(losses[k])
        if math.isfinite(loss) and (best is None or (cost, -loss) > (best.cost, -best.loss)):
            self.provisional = Provisional(cost, loss, np.array(thetas[k], dtype=float))

    def reject(self, reason: str, count: int = 1, at: str = "") -> None:
        """Count unusable values by reason; beyond REASONS different reasons, others count together.

        Reasons that differ in numbers only count as one. The first configuration of a reason, `at`,
        is added to it.
        """
        kind = NUMBER.sub("#", reason)
        reasons = [k for k in self.rejected if NUMBER.sub("#", k.split(FIRST)[0]) == kind]
        if not reasons:
            full = len(self.rejected) >= REASONS
            reasons = ["other reasons" if full else f"{reason}{FIRST}{at}" if at else reason]
        self.rejected[reasons[0]] += count


@dataclass(frozen=True)
class Clock:
    """Clocks of a run, both monotone.

    Parameters
    ----------
    wall, cpu : callable, optional
        Return the wall time and the CPU time [s], by default of this process. Tests and
        simulations replace them.
    """

    wall: Callable[[], float] = time.perf_counter
    cpu: Callable[[], float] = time.process_time
