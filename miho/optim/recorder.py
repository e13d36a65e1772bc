"""Clock, count of evaluations and improvements of one run."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from miho.compiled import Block
from miho.optim.meter import Clock, Meter
from miho.optim.space import Space
from miho.quantities import Array

OBSERVE_SECONDS = 0.1
CHUNK_SECONDS = 0.02
"""Seconds of evaluations between two checks of the clock."""
CHECKED_AT_ONCE = 1024
OFF_A_ROW, ROUNDED = 1e-6, 1e-15
"""Tolerance of a sum of fractions as a whole number of rows, absolute and relative."""
NO_LOSSES, NOWHERE = np.empty(0), np.empty(0, np.int64)


class Recorder:
    """Counts evaluations up to `limit` and records improvements, in a `meter`.

    The clock runs while the method and the problem compute. It stops while an improvement is
    recorded and during `observe`, about ten times a second. `rows` is the number of rows of data,
    None if fidelities are not fractions of rows.
    """

    def __init__(
        self,
        meter: Meter,
        space: Space,
        limit: float,
        rows: int | None,
        clock: Clock,
        observe: Callable[[], None] | None,
    ) -> None:
        self.meter = meter
        self._d = len(space)
        self._box = space.widened
        self._limit = limit
        self._rows = rows
        self._clock = clock
        self._observe = observe
        self._observed = -math.inf
        self._unchecked: list[Array] = []
        self._rows_unchecked = 0
        self.evaluated = self.evaluating = 0.0  # evaluations, and the seconds of all
        self._wall = clock.wall() - meter.seconds
        self._cpu = clock.cpu() - meter.cpu_seconds

    @property
    def seconds(self) -> float:
        """Seconds on the clock of the method, without set-up and recording."""
        return self._clock.wall() - self._wall

    def stop(self) -> None:
        """Read the clocks for the last time, and count the configurations not counted yet."""
        self.meter.seconds = self.seconds
        self.meter.cpu_seconds = self._clock.cpu() - self._cpu
        self._check_box()

    def record(
        self, at: Array, losses: Array, thetas: Array, evaluations: float, started: float
    ) -> None:
        """Count evaluations and record their improvements, with the clock stopped meanwhile.

        `at` (k,) is the evaluation of each improvement within the block, and `started` the clock
        before the block. The time of an improvement assumes that all evaluations of the block take
        equally long.
        """
        meter = self.meter
        meter.seconds = now = self._clock.wall() - self._wall
        self.evaluated += evaluations
        self.evaluating += now - started
        if at.size:
            meter.cpu_seconds = self._clock.cpu() - self._cpu
            per_evaluation = (now - started) / evaluations
            for count, loss, theta in zip(at.tolist(), losses.tolist(), thetas, strict=True):
                meter.trace.add(
                    self.count_after(count),
                    now - per_evaluation * (evaluations - count),
                    meter.cpu_seconds,
                    loss,
                    theta,
                )
            meter.best = meter.trace.loss[-1]
            self._wall = self._clock.wall() - now
            self._cpu = self._clock.cpu() - meter.cpu_seconds
        self.charge(evaluations)
        if self._observe is not None and now - self._observed >= OBSERVE_SECONDS:
            self._observed = now
            cpu = self._clock.cpu()
            self._observe()
            self._cpu += self._clock.cpu() - cpu
            self._wall = self._clock.wall() - now

    @property
    def at_once(self) -> float:
        """Evaluations between two checks of the clock, by the rate so far."""
        meter = self.meter
        return CHUNK_SECONDS * meter.evaluations / meter.seconds if meter.seconds > 0 else 0.0

    def affords(self, evaluations: float) -> bool:
        """Whether the limit covers this number of further evaluations, up to rounding."""
        return self.count_after(evaluations) <= self._limit

    def chunk(self, rows: int, cost: float) -> int:
        """Number of rows to evaluate before the next check of the clock, within the limit."""
        if rows > 1:
            rows = min(rows, max(1, int(self.at_once / cost)))
        if not self.affords(rows * cost):
            rows = int((self._limit - self.meter.evaluations) / cost)
            rows += self.affords((rows + 1) * cost)
        return rows

    def losses(self, rows: Array, losses: Array, cost: float, started: float) -> None:
        """Record a batch of configurations (n, d) and losses (n,) with its improvements."""
        meter, least = self.meter, np.minimum.reduce(losses)
        if meter.starts.current is not None and cost == 1.0:
            meter.starts.current.see(rows, losses)
        if cost == 1.0 and least < meter.best:
            lower = losses < np.minimum.accumulate(np.append(meter.best, losses[:-1]))
            improving = np.flatnonzero(lower)
            improved, thetas = losses[improving], rows[improving]
        else:
            improving, improved, thetas = NOWHERE, NO_LOSSES, rows[:0]
            if meter.best == math.inf and losses.size:
                meter.note(cost, losses, rows)
        at = (improving + 1).astype(float)
        self.record(at, improved, thetas, losses.size * cost, started)

    def block(self, block: Block, started: float) -> None:
        """Record the evaluations and improvements of a compiled block."""
        for reason, count in block.rejected.items():
            if count:
                self.meter.reject(reason, count)
        if block.provisional is not None:
            self.meter.note(*block.provisional)
        if block.losses.size:
            self.count_outside(block.thetas)  # a block reports improvements only
        self.record(block.at, block.losses, block.thetas, block.evaluations, started)

    def derivatives(self, cost: float) -> None:
        """Count derivatives."""
        self.charge(cost)
        self.meter.seconds = self.seconds

    def charge(self, evaluations: float) -> None:
        """Count evaluations that were allowed; only rounding can exceed the limit."""
        self.meter.evaluations = min(self.count_after(evaluations), self._limit)

    def count_after(self, evaluations: float) -> float:
        """Count after further evaluations; it does not depend on how they were divided into blocks.

        On rows of data it is a whole number of rows, divided once: sums of fractions would differ
        in their last bits.
        """
        count = self.meter.evaluations + evaluations
        if self._rows is None:
            return count
        rows = count * self._rows
        nearest = round(rows)
        near = abs(rows - nearest) <= OFF_A_ROW + ROUNDED * rows
        return nearest / self._rows if near else count

    def count_outside(self, thetas: Array) -> None:
        """Count the configurations (n, d) outside the bounds, many at once.

        A check of ten costs as much as a check of a thousand.
        """
        if thetas.shape[1:] != (self._d,):
            raise ValueError(
                f"configurations have the shape {thetas.shape}; expected (n, {self._d})"
            )
        self._unchecked.append(thetas.copy())
        self._rows_unchecked += len(thetas)
        if self._rows_unchecked >= CHECKED_AT_ONCE:
            self._check_box()

    def _check_box(self) -> None:
        if self._unchecked:
            thetas = np.concatenate(self._unchecked)
            within = (thetas >= self._box[0]) & (thetas <= self._box[1])
            self.meter.outside += len(thetas) - int(np.count_nonzero(within.all(axis=1)))
            self._unchecked, self._rows_unchecked = [], 0
