"""Records of a run: its improvements over time, and the ends of its descents."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from miho.optim.evidence import Agreement, agreement, in_optimum
from miho.quantities import Array

MOST_ENDS = 1000
MOST_MINIMA = 20
"""Largest number of minima that a run keeps: a report descends from each that may be within the
noise, and a reader cannot compare more."""
SAME_PLACE = 1e-3
"""Two descents ended in one place if each parameter differs by less than this share of its size."""


@dataclass
class Trace:
    """Columns of equal length, a row per improvement of the best loss.

    Attributes
    ----------
    evaluations : list of float
        Full evaluations up to and including the improvement.
    seconds, cpu_seconds : list of float
        Wall and CPU time on the clock of the method, without set-up and recording.
    loss : list of float
        Best losses, which decrease strictly.
    theta : list of ndarray, each of shape (d,)
        Configurations, in units.

    Examples
    --------
    >>> from miho.optim import Trace
    >>> trace = Trace()
    >>> trace.add(evaluations=3, seconds=0.1, cpu_seconds=0.1, loss=2.5, theta=[1.0])
    >>> len(trace), trace.loss
    (1, [2.5])
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
    """One descent of a method that makes several: its losses at the start and at the end.

    Attributes
    ----------
    start : float
        Loss of the start over all rows; math.inf if the start was evaluated on fewer.
    end : float
        Smallest loss over all rows.
    finished : bool
        False if the budget, an interrupt or non-finite values cut the descent off.
    converged : bool
        Whether its solver has converged.
    theta : ndarray of shape (d,) or None
        Configuration of the smallest loss, in units; None if unknown.
    """

    start: float = math.inf
    end: float = math.inf
    finished: bool = False
    converged: bool = False
    theta: Array | None = None

    @property
    def improved(self) -> bool:
        """Whether its end is better than its start."""
        return self.end < self.start

    def see(self, thetas: Array, losses: Array) -> None:
        """Record a batch of configurations (n, d) with losses (n,); the first one is the start."""
        if self.start == math.inf:
            self.start = float(losses[0])
        best = losses.argmin()
        if losses[best] < self.end:
            self.end, self.theta = float(losses[best]), thetas[best].copy()


@dataclass
class Starts:
    """Starts and descents of a run so far.

    Attributes
    ----------
    screened : int
        Configurations that were evaluated, on any number of rows, to choose starts.
    descents : list of Descent
        The descents in order.
    rounding : float
        Losses that differ by less than this count as equal.
    dropped : int
        Further descents that ended on fewer than all rows, no better than a known optimum, so that
        their final loss is unknown.
    brackets : bool
        Whether a descent is the last candidate of a bracket of successive halving.
    exhausted : bool
        Whether the method ended at its largest number of brackets, without enough evidence.
    current : Descent or None
        The descent to which the next evaluations belong.
    """

    screened: int = 0
    descents: list[Descent] = field(default_factory=list)
    rounding: float = 0.0
    dropped: int = 0
    brackets: bool = False
    exhausted: bool = False
    current: Descent | None = None

    @contextmanager
    def descent(self) -> Iterator[Descent]:
        """Record the enclosed evaluations as one descent of this run.

        For methods that descend from several starts: the agreement of their ends is the evidence
        for the optimum. The method sets `converged`.
        """
        self.current = descent = Descent()
        self.descents.append(descent)
        try:
            yield descent
            descent.finished = True
        finally:
            self.current = None

    def add(
        self,
        start: float,
        end: float,
        *,
        converged: bool = True,
        finished: bool = True,
        theta: Array | None = None,
    ) -> None:
        """Record a descent whose steps alternate with steps of other descents.

        Parameters
        ----------
        start, end : float
            Losses over all rows; `start` is math.inf if the start was not evaluated on all rows. A
            return to a known optimum has the `end` and `theta` of this optimum.
        converged, finished : bool, optional
            Whether the solver converged, and whether the descent came to its end.
        theta : ndarray of shape (d,), optional
            The end, in units.
        """
        self.descents.append(Descent(float(start), float(end), finished, converged, theta))

    def agreement(self, best: float) -> Agreement:
        """Agreement of the ends of the finished descents on the run's `best` loss.

        A method may stop if the agreement is `enough`. If the best loss is not at an end of a
        descent, no descent agrees with it.
        """
        return agreement(self.ends, self.rounding, best=best, dropped=self.dropped)

    @property
    def finished(self) -> list[Descent]:
        """Descents that came to an end, with a finite loss."""
        return [each for each in self.descents if each.finished and -math.inf < each.end < math.inf]

    @property
    def ends(self) -> list[float]:
        """Losses at the ends of finished descents, in order."""
        return [each.end for each in self.finished]


class Minimum(NamedTuple):
    """A place where descents ended.

    Attributes
    ----------
    loss : float
        The loss.
    theta : tuple of float, of length d
        The parameters, in units.
    """

    loss: float
    theta: tuple[float, ...]


def best_minima(descents: Iterable[Descent]) -> tuple[Minimum, ...]:
    """Different places where descents ended, the best first, at most MOST_MINIMA."""
    minima: list[Minimum] = []
    located = {  # many descents return to the same place, to the last bit
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


def in_place(theta: Sequence[float] | Array, known: Array) -> bool:
    """Whether each parameter (d,) differs from a known place (d,) by at most SAME_PLACE."""
    return all(abs(a - b) <= SAME_PLACE * abs(b) for a, b in zip(theta, known, strict=True))


def _same_place(known: Minimum, theta: Array, end: float, near: Array) -> bool:
    """Whether parameters `theta` (d,) are in the same place as a known minimum.

    `near` (d,) is a tolerance that applies only if the losses agree: one far descent makes it wide.
    """
    apart, sizes = np.abs(theta - known.theta), np.maximum(np.abs(theta), np.abs(known.theta))
    agree = in_optimum(known.loss, end) and (apart <= near).all()
    return bool(agree or (apart <= SAME_PLACE * sizes).all())


@dataclass(frozen=True)
class Descents:
    """Stored summary of a run's descents.

    Attributes
    ----------
    started, finished, converged, stayed : int
        Numbers of descents that started, that came to an end, that converged by their solver, and
        that ended no better than they started.
    ends : tuple of float
        Losses at the ends of finished descents, ascending, at most MOST_ENDS, without `dropped`.
    screened : int
        Configurations from which the starts were chosen.
    agreeing : int, optional
        Descents that ended in the optimum of the run's best loss; None if not counted.
    dropped : int
        Descents that ended on fewer than all rows, no better than a known optimum.
    brackets : bool
        Whether a descent is the last candidate of a bracket of successive halving.
    settled : bool
        Whether a method of brackets ended because the evidence was enough.
    minima : tuple of Minimum
        Different places where the best descents ended, as far as the method records them.

    Notes
    -----
    Runs of older versions lack the fields with a default.
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
        """Summary for a run's best loss; None if the method neither screens nor descends.

        `ended`: the method has ended by itself.
        """
        if not (starts.descents or starts.screened):
            return None
        finished, dropped = starts.finished, starts.dropped
        ends = sorted(descent.end for descent in finished)
        return cls(
            started=len(starts.descents) + dropped,
            finished=len(finished) + dropped,
            converged=sum(descent.converged for descent in finished) + dropped,
            stayed=sum(not descent.improved for descent in finished),
            ends=tuple(ends[:MOST_ENDS]),
            screened=starts.screened,
            agreeing=starts.agreement(best).agreeing,
            dropped=dropped,
            brackets=starts.brackets,
            settled=not starts.brackets or (ended and not starts.exhausted),
            minima=best_minima(finished),
        )

    @classmethod
    def together(cls, searches: Iterable[Descents]) -> Descents:
        """Summary of all descents of several searches; their agreement is not counted."""
        each = list(searches)
        counts = ("started", "finished", "converged", "stayed", "screened", "dropped")
        return cls(
            **{name: sum(getattr(search, name) for search in each) for name in counts},
            ends=tuple(sorted(end for search in each for end in search.ends)),
            brackets=bool(each) and all(search.brackets for search in each),
            settled=all(search.settled for search in each),
            minima=tuple(minimum for search in each for minimum in search.minima),
        )

    def agreement(self, best: float, rounding: float) -> Agreement:
        """Agreement of the ends on an optimum of the loss `best`; see `miho.optim.agreement`."""
        return agreement(
            self.ends, rounding, best=best, finished=self.finished, dropped=self.dropped
        )

    def kind(self, count: int = 1) -> str:
        """The name of this number of descents."""
        if self.brackets:
            return "independent search" + "es" * (count > 1)
        return "descent" + "s" * (count > 1)

    @classmethod
    def from_stored(cls, record: Mapping[str, Any]) -> Descents:
        """Summary from its JSON form."""
        minima = tuple(Minimum(loss, tuple(theta)) for loss, theta in record.get("minima", ()))
        return cls(**{**record, "ends": tuple(record["ends"]), "minima": minima})
