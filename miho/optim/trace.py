"""What a run records: its error over time, a row per improvement, and where its descents ended."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from miho.optim.evidence import Agreement, agreement, in_optimum
from miho.quantities import Array

MOST_ENDS = 1000
MOST_MINIMA = 20
"""Locations of minima that a run keeps: a report descends from each that may be within the noise,
and a reader can compare no more."""
SAME_PLACE = 1e-3
"""Descents that ended within this share of each parameter's size ended in one place."""


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
    """One descent of a method that makes several: the losses where it started and where it ended.

    `end` is its smallest loss, `theta` (d,) where that is, None if it is not known. `finished`
    unless the budget, an interrupt or values that are no numbers cut it off; `converged` if its
    solver says so. Losses are those over all rows; `start` is math.inf where the start was
    evaluated on fewer only.
    """

    start: float = math.inf
    end: float = math.inf
    finished: bool = False
    converged: bool = False
    theta: Array | None = None

    @property
    def improved(self) -> bool:
        """Whether it ended better than it started."""
        return self.end < self.start

    def see(self, thetas: Array, losses: Array) -> None:
        """Take in a batch of configurations (n, d) with losses (n,); the first is the start's."""
        if self.start == math.inf:
            self.start = losses[0]
        best = losses.argmin()
        if losses[best] < self.end:
            self.end, self.theta = losses[best], thetas[best].copy()


@dataclass
class Starts:
    """The starts of a run so far: how many were `screened`, and the descents from the best of them.

    A configuration is screened if it is looked at, on few rows or on all, to decide whether to
    descend from it. `descents` are in their order. `dropped` counts further ones that ended on
    fewer rows than all, where a known optimum is no worse: their losses over all rows are not
    known. With `brackets` a descent is the last candidate of a bracket of successive halving.
    `exhausted` if the method ended at its largest number of brackets, not by its evidence. Losses
    that differ by less than `rounding` count as equal.
    """

    screened: int = 0
    descents: list[Descent] = field(default_factory=list)
    rounding: float = 0.0
    dropped: int = 0
    brackets: bool = False
    exhausted: bool = False

    def add(
        self,
        start: float,
        end: float,
        *,
        converged: bool = True,
        finished: bool = True,
        theta: Array | None = None,
    ) -> None:
        """Add a descent from a loss to a loss, as `Descent` describes them."""
        self.descents.append(Descent(start, end, finished, converged, theta))

    def agreement(self, best: float) -> Agreement:
        """How the ends of the finished descents agree on the run's `best` loss.

        A method may stop if it is `enough`. Where the best was seen elsewhere than at an end, no
        descent agrees with it.
        """
        return agreement(self.ends, self.rounding, best=best, dropped=self.dropped)

    @property
    def finished(self) -> list[Descent]:
        """The descents that came to an end, with a finite loss."""
        return [
            descent for descent in self.descents if descent.finished and math.isfinite(descent.end)
        ]

    @property
    def ends(self) -> list[float]:
        """The losses where those ended, in the order of the descents."""
        return [
            float(each.end) for each in self.descents if each.finished and abs(each.end) < math.inf
        ]


class Minimum(NamedTuple):
    """Where descents ended: the loss, and the parameters (d,) in units."""

    loss: float
    theta: tuple[float, ...]


def best_minima(descents: Iterable[Descent]) -> tuple[Minimum, ...]:
    """The different places where descents ended, the best first, MOST_MINIMA of them at most."""
    minima: list[Minimum] = []
    located = {  # many come back to one place, to its last bit
        (descent.end, descent.theta.tobytes()): descent.theta
        for descent in descents
        if descent.theta is not None
    }
    near = SAME_PLACE * np.abs([*located.values()]).max(axis=0, initial=0.0)
    for (end, _), theta in sorted(located.items(), key=lambda each: each[0][0]):
        if not any(_same_place(known, theta, end, near) for known in minima):
            minima.append(Minimum(float(end), tuple(map(float, theta))))
        if len(minima) == MOST_MINIMA:
            break
    return tuple(minima)


def _same_place(known: Minimum, theta: Array, end: float, near: Array) -> bool:
    """Whether a descent to parameters `theta` (d,) ended where another is known to have ended.

    Within `near` (d,) only if their losses agree: where a third one ended far out, that is wide.
    """
    apart, sizes = np.abs(theta - known.theta), np.maximum(np.abs(theta), np.abs(known.theta))
    agree = in_optimum(known.loss, end) and (apart <= near).all()
    return bool(agree or (apart <= SAME_PLACE * sizes).all())


@dataclass(frozen=True)
class Descents:
    """The summary of a run's descents, as it is stored: how many there were, where they ended.

    `ends` are the losses of those that finished, ascending, the best MOST_ENDS of them, without the
    `dropped` ones: those ended on fewer rows than all, no better than a known optimum, so that
    their losses over all rows are not known. `converged` counts the finished ones whose solver says
    so, `stayed` those that ended no better than they started. `screened` counts the configurations
    from which the starts were chosen, `agreeing` the descents that ended in the optimum of the
    run's best loss (None: not counted). With `brackets` a descent is the last candidate of a
    bracket of successive halving; a method of brackets judges their ends itself, and `settled` says
    whether it has ended because they were evidence enough. `minima` are the different places where
    the best of them ended, as far as their method says where. Runs of older versions lack the
    fields that have a default.
    """

    started: int
    finished: int
    converged: int
    stayed: int
    ends: tuple[float, ...]
    screened: int = 0
    agreeing: int | None = None
    dropped: int = 0
    brackets: bool = False
    settled: bool = True
    minima: tuple[Minimum, ...] = ()

    @classmethod
    def of(cls, starts: Starts, best: float, ended: bool = True) -> Descents | None:
        """The summary, for a run's best loss; None if the method neither screens nor descends.

        `ended` if the method has ended by itself.
        """
        if not (starts.descents or starts.screened):
            return None
        finished, dropped = starts.finished, starts.dropped
        return cls(
            started=len(starts.descents) + dropped,
            finished=len(finished) + dropped,
            converged=sum(descent.converged for descent in finished) + dropped,
            stayed=sum(not descent.improved for descent in finished),
            ends=tuple(sorted(starts.ends)[:MOST_ENDS]),
            screened=starts.screened,
            agreeing=starts.agreement(best).agreeing,
            dropped=dropped,
            brackets=starts.brackets,
            settled=not starts.brackets or (ended and not starts.exhausted),
            minima=best_minima(finished),
        )

    @classmethod
    def from_stored(cls, record: Mapping[str, Any]) -> Descents:
        """The summary from what JSON keeps of it; raises for other things."""
        minima = tuple(Minimum(loss, tuple(theta)) for loss, theta in record.get("minima", ()))
        return cls(**{**record, "ends": tuple(record["ends"]), "minima": minima})
