"""What a run may spend, what it has spent and seen, and the exceptions that end it."""

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
from miho.validate import positive, whole

REASONS = 20
"""Reasons for rejected values that are counted one by one."""
FIRST = "; first at "
"""What stands between the reason for a rejected value and its first configuration."""
NUMBER = re.compile(
    r"(?<!\.py:)(?<!\w)(?:0x[0-9a-f]+|[-+]?(?:\d[\d_]*(?:\.\d*)*|\.\d+)(?:[eE][-+]?\d+)?)"
)
"""A number in a reason, which may vary: not one in a name, such as x1, and not that of a line."""


class BudgetExhausted(Exception):  # noqa: N818 -- the signal that ends every run, not an error
    """Raised by the oracle when its budget is spent or its target is reached."""


class RunInterrupted(KeyboardInterrupt):
    """Raised by the oracle between two evaluations after Ctrl-C: the state is whole."""


class UnusableValueError(ValueError):
    """Raised by the oracle where residuals or derivatives cannot be computed."""


@dataclass(frozen=True)
class Budget:
    """What one run may spend; a limit of None does not bind.

    `evaluations` is exact: not one more is made. `seconds` of the method's clock are checked
    after every chunk of about 20 ms. A run also ends at a loss of `target` or below.
    """

    evaluations: int | None = None
    seconds: float | None = None
    target: float | None = None

    def __post_init__(self) -> None:
        if self.evaluations is not None:
            whole("budget.evaluations", self.evaluations, 1)
        if self.seconds is not None:
            positive("budget.seconds", self.seconds)
        if self.target is not None and not math.isfinite(self.target):
            raise ValueError(f"budget.target is {self.target!r}; expected a finite loss")


class Provisional(NamedTuple):
    """The best configuration `theta` (d,) while none was looked at on all rows of data.

    `cost` is the share of the rows that it was looked at on, in evaluations, and `loss` that over
    these rows. More rows are better than fewer, whatever the loss over them.
    """

    cost: float
    loss: float
    theta: Array


@dataclass
class Arrivals:
    """In which order the evaluations of a run were there, as far as a method asked for it.

    After `alone` evaluations, made one at a time, so many `workers` made them, 0 as long as they do
    not. `positions` are the answers of `Oracle.first_ready` where there was a choice.
    """

    workers: int = 0
    positions: list[int] = field(default_factory=list)
    alone: float = 0


@dataclass
class Meter:
    """What a run has spent and seen; with the method's state, all that a resumed run needs.

    `unfinished` holds the losses of a batch that was cut off: the same batch, evaluated again, goes
    on after them. `rejected` counts the values that could not be used, by reason. `outside` counts
    configurations outside of the space's box: their values are used, but a method is to stay in it.
    `starts` are those of a method that descends from several. `arrivals` are those by which a
    method decided that works asynchronously. `provisional` is the best configuration on fewer rows
    than all, noted until one is looked at on all of them.
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
    arrivals: Arrivals = field(default_factory=Arrivals)
    provisional: Provisional | None = None

    def note(self, cost: float, losses: Array, thetas: Array) -> None:
        """Note the best of some configurations (n, d) if none is known on as many rows or more."""
        k = int(np.argmin(losses))
        known, loss = self.provisional, float(losses[k])
        if math.isfinite(loss) and (known is None or (cost, -loss) > (known.cost, -known.loss)):
            self.provisional = Provisional(cost, loss, np.array(thetas[k], dtype=float))

    def reject(self, reason: str, count: int = 1, at: str = "") -> None:
        """Count values that cannot be used, by reason; beyond REASONS of them, together.

        Reasons that differ in numbers only are one. `at` is the configuration, which stands behind
        the reason where it is the first one.
        """
        kind = NUMBER.sub("#", reason)
        known = [k for k in self.rejected if NUMBER.sub("#", k.split(FIRST)[0]) == kind]
        if not known:
            other = len(self.rejected) >= REASONS
            known = ["other reasons" if other else f"{reason}{FIRST}{at}" if at else reason]
        self.rejected[known[0]] += count


@dataclass(frozen=True)
class Clock:
    """Seconds of wall and of CPU time, each monotone."""

    wall: Callable[[], float] = time.perf_counter
    cpu: Callable[[], float] = time.process_time
