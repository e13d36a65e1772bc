"""What one run leaves: its error over time, a row per improvement, and where its descents ended."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_ENDS = 1000


@dataclass
class Trace:
    """Columns of equal length, a row per improvement of the best loss.

    `evaluations` counts full evaluations up to and including the improving one; `seconds` and
    `cpu_seconds` are the method's own clock, without set-up and recording; `loss` decreases
    strictly; `theta` is in units.
    """

    evaluations: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    cpu_seconds: list[float] = field(default_factory=list)
    loss: list[float] = field(default_factory=list)
    theta: list[Array] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.loss)

    def add(
        self, evaluations: float, seconds: float, cpu_seconds: float, loss: float, theta: Array
    ) -> None:
        """Append one improvement."""
        self.evaluations.append(evaluations)
        self.seconds.append(seconds)
        self.cpu_seconds.append(cpu_seconds)
        self.loss.append(loss)
        self.theta.append(np.array(theta, dtype=float))


@dataclass
class Descent:
    """One descent of a method that makes several: the loss where it started, and its smallest.

    `finished` unless the budget, an interrupt or values that are no numbers cut it off;
    `converged` if its solver says that nothing more is to be gained.
    """

    start: float = math.inf
    end: float = math.inf
    finished: bool = False
    converged: bool = False

    @property
    def moved(self) -> bool:
        """Whether it found anything better than its start."""
        return self.end < self.start

    def see(self, first: float, least: float) -> None:
        """Take in the first and the least loss of a batch; the first of all is the start's."""
        if self.start == math.inf:
            self.start = first
        if least < self.end:
            self.end = least


@dataclass(frozen=True)
class Descents:
    """What is kept of the descents of one run: how many there were, and where they ended.

    `ends` are the losses of those that finished, ascending, the best MOST_ENDS of them;
    `converged` counts those of the finished whose solver had nothing more to gain, `stayed` those
    that found nothing better than their start.
    """

    started: int
    finished: int
    converged: int
    stayed: int
    ends: tuple[float, ...]

    @classmethod
    def of(cls, descents: Sequence[Descent]) -> Descents | None:
        """The summary; None for a method that makes no descents."""
        if not descents:
            return None
        finished = [one for one in descents if one.finished and math.isfinite(one.end)]
        return cls(
            started=len(descents),
            finished=len(finished),
            converged=sum(one.converged for one in finished),
            stayed=sum(not one.moved for one in finished),
            ends=tuple(sorted(float(one.end) for one in finished)[:MOST_ENDS]),
        )
