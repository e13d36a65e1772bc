"""One run's metered view of a problem: the only door between a method and the loss."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miho.compiled import Block, Kernel
from miho.optim.evidence import Agreement
from miho.optim.meter import (
    Budget,
    BudgetExhausted,
    Clock,
    Meter,
    RunInterrupted,
    UnusableValueError,
)
from miho.optim.problem import LeastSquaresProblem, Problem, mean_square
from miho.optim.space import Space
from miho.optim.trace import Descent, Trace
from miho.quantities import Array

CHUNK_SECONDS = 0.02
OBSERVE_SECONDS = 0.1
CHECKED_AT_ONCE = 1024
OFF_A_ROW, ROUNDED = 1e-6, 1e-15
"""How far a sum of fractions may be off a whole number of rows, besides a few roundings of it."""
NOT_FINITE = "loss is"
"""So begins the reason why a value was rejected that was computed and is not finite."""
NONE, NOWHERE = np.empty(0), np.empty(0, np.int64)
UNSENT = "KeyboardInterrupt, though nobody interrupted it"
"""What ends a run whose model or method raises what only a signal should."""


class Oracle:
    """Counts, times, limits and records every evaluation of one run.

    Calling it evaluates a batch in order; an improvement inside a batch is recorded at its own
    evaluation. Values that are not finite numbers come back as +inf and never become best.
    `rows` is how many rows of data there are, if a fidelity takes the first of them, else None.
    `state` is the place where a resumable method leaves its state. Once `interrupted` is set, the
    run ends with RunInterrupted at its next evaluation.
    """

    def __init__(
        self,
        problem: Problem,
        budget: Budget,
        *,
        space: Space | None = None,
        meter: Meter | None = None,
        observer: Callable[[Oracle], None] | None = None,
        clock: Clock | None = None,
    ) -> None:
        self.budget = budget
        self.space = problem.space if space is None else space
        self.rows = problem.rows
        self.meter = Meter() if meter is None else meter
        self.meter.starts.rounding = max(problem.rounding, problem.resolution)
        self.state: Any = None
        self.interrupted = False
        self._box = self.space.rounded
        self._problem = problem
        self._limit = math.inf if budget.evaluations is None else budget.evaluations
        self._deadline = math.inf if budget.seconds is None else budget.seconds
        self._target = -math.inf if budget.target is None else budget.target
        self._observer = observer
        self._clock = Clock() if clock is None else clock
        self._unchecked: list[Array] = []
        self._rows_unchecked = 0
        self._observed = -math.inf
        self._descent: Descent | None = None
        self._wall = self._clock.wall() - self.meter.seconds
        self._cpu = self._clock.cpu() - self.meter.cpu_seconds

    @property
    def evaluations(self) -> float:
        """Full evaluations so far; at a lower fidelity they count what the problem says."""
        return self.meter.evaluations

    @property
    def seconds(self) -> float:
        """Seconds of the method's clock: the run without set-up and recording."""
        return self._clock.wall() - self._wall

    @property
    def remaining(self) -> float:
        """Evaluations left, math.inf without a limit."""
        return self._limit - self.meter.evaluations

    @property
    def remaining_seconds(self) -> float:
        """Seconds of the method's clock left, math.inf without a limit."""
        return self._deadline - self.seconds

    @property
    def best(self) -> float:
        """The smallest finite loss so far, math.inf before the first."""
        return self.meter.best

    @property
    def linear(self) -> tuple[str, ...]:
        """The parameters in which the residuals are jointly linear, as the problem declares."""
        return self._least_squares.linear

    @property
    def trace(self) -> Trace:
        """The improvements so far."""
        return self.meter.trace

    def __call__(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Losses (n,) of rows (n, d) in units; raises BudgetExhausted at the end of the budget."""
        self._check_open()
        if not 0 < fidelity <= 1:
            raise ValueError(f"fidelity is {fidelity!r}; expected a fraction above 0, at most 1")
        cost = self._problem.cost(fidelity)
        unfinished = self.meter.unfinished
        losses = np.array(unfinished) if unfinished else NONE
        n = len(thetas)
        try:
            while losses.size < n:
                rows = thetas[losses.size : losses.size + self._chunk(n - losses.size, cost)]
                if not len(rows):
                    raise BudgetExhausted
                started = self.seconds
                self._count_outside(rows)
                chunk = self._losses(rows, fidelity)
                self._record(rows, chunk, cost, started)
                losses = np.concatenate((losses, chunk)) if losses.size else chunk
                self._check_end()
        except BaseException:
            unfinished[:] = losses.tolist()
            raise
        if unfinished:
            unfinished.clear()
        return losses

    @property
    def kernel(self) -> Kernel | None:
        """Compiled forms of the problem's loss, for blocks of evaluations (`spend`)."""
        return self._problem.kernel

    @property
    def order(self) -> NDArray[np.intp] | None:
        """The order in which a fidelity takes the rows of all residuals, None if it is theirs."""
        return self._least_squares.order

    @property
    def jacobian_cost(self) -> int:
        """What the derivatives of the residuals cost, in evaluations of the same rows."""
        cost = self._least_squares.jacobian_cost
        return len(self.space) if cost is None else cost

    @property
    def rounding(self) -> float:
        """A loss up to this is 0: its digits are rounding."""
        return self._problem.rounding

    @property
    def resolution(self) -> float:
        """Losses that differ by no more than this are one."""
        return self.meter.starts.rounding

    @property
    def noise(self) -> float:
        """A loss above this is more than the noise of the data explains, as far as is known."""
        return self._problem.noise

    def affords(self, evaluations: float) -> bool:
        """Whether the budget can pay for so many more evaluations, whatever their rounding."""
        return self._after(evaluations) <= self._limit

    def cost(self, fidelity: float) -> float:
        """What one evaluation at a fidelity costs, in full evaluations."""
        return self._problem.cost(fidelity)

    def residuals(self, theta: Array, fidelity: float = 1.0, *, goes_on: bool = False) -> Array:
        """Residuals (m,) of one configuration (d,) in units: one evaluation of so many rows.

        A run ends before an evaluation, never between it and the use of its value; nor before one
        that `goes_on` with the one before, unless it cannot pay for it.

        Raises UnusableValueError if the problem raises; residuals that are not finite are
        returned as they are, for solvers that know what to do with them.
        """
        problem = self._least_squares
        some, cost = self._of_rows(fidelity)
        if not goes_on:
            self._check_open()
        if not self.affords(cost):
            raise BudgetExhausted
        started = self.seconds
        self._count_outside(theta[None])
        try:
            residuals = _real(problem.residuals(_read_only(theta), *some))
            loss = self._usable(mean_square(residuals)[None])
        except Exception as error:
            self.meter.reject(f"{type(error).__name__}: {error}")
            self._record(theta[None], np.array([math.inf]), cost, started)
            raise UnusableValueError(str(error)) from error
        self._record(theta[None], loss, cost, started)
        return residuals

    def residual_rows(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Residuals (k, m) of the first k of some configurations (n, d): k evaluations.

        As many as fit between two looks at the clock, and as the budget pays for; with none left it
        is exhausted. A row is NaN where the problem raises.
        """
        some, cost = self._of_rows(fidelity)
        self._check_open()
        rows = thetas[: self._chunk(len(thetas), cost)]
        if not len(rows):
            raise BudgetExhausted
        started = self.seconds
        self._count_outside(rows)
        try:
            residuals = _real(self._least_squares.residual_rows(_read_only(rows), *some))
            losses = self._usable(mean_square(residuals))
        except Exception:  # noqa: BLE001 -- whatever a model raises, or it has no such rows
            residuals, losses = self._one_by_one(rows, some)
        self._record(rows, losses, cost, started)
        return residuals

    def _one_by_one(self, rows: Array, some: tuple[float, ...]) -> tuple[Array, Array]:
        """Residuals (n, m), NaN where the problem raises, and losses (n,)."""
        found: dict[int, Array] = {}
        losses = np.full(len(rows), math.inf)
        for k, theta in enumerate(rows):
            try:
                values = _real(self._least_squares.residuals(_read_only(theta), *some))
                losses[k] = self._usable(mean_square(values)[None])[0]
                found[k] = values.copy()
            except Exception as error:  # noqa: BLE001 -- as for residuals
                self.meter.reject(f"{type(error).__name__}: {error}")
        residuals = np.full((len(rows), max((r.size for r in found.values()), default=1)), math.nan)
        for k, values in found.items():
            residuals[k] = values
        return residuals, losses

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Derivatives of the residuals (m, d) at one configuration (d,) in units.

        Costs `jacobian_cost` evaluations; a budget that cannot pay it is exhausted. Raises
        UnusableValueError if the problem raises or a derivative is not finite.
        """
        problem = self._least_squares
        some, cost = self._of_rows(fidelity)
        cost *= self.jacobian_cost
        self._check_open()
        if not self.affords(cost):
            raise BudgetExhausted
        reason = "derivative is not finite"
        try:
            jacobian = _real(problem.jacobian(_read_only(theta), *some))
            usable = bool(np.isfinite(jacobian).all())
        except Exception as error:  # noqa: BLE001 -- as for residuals
            reason, usable = f"{type(error).__name__}: {error}", False
        self._spend(cost)
        self.meter.seconds = self.seconds
        if not usable:
            self.meter.reject(reason)
            raise UnusableValueError(reason)
        return jacobian

    def _of_rows(self, fidelity: float) -> tuple[tuple[float, ...], float]:
        """A fidelity as a problem takes it, which need not know of any, and its cost."""
        if fidelity == 1.0:
            return (), 1.0
        return (fidelity,), self._problem.cost(fidelity)

    def spend(self, block: Callable[[float, float, float], Block], least: float) -> None:
        """Let compiled code evaluate in blocks of some 20 ms until it is done.

        `block(most, best, target)` spends no more than `most` evaluations and reports what it did,
        each improvement at its own evaluation; the state of its method is then whole, and it goes
        on there when it is called again. `least` is what it may need for its next step: a budget
        that cannot pay it is exhausted. Raises, as an evaluation would, where the run is over.
        """
        meter = self.meter
        while True:
            self._check_open()
            rate = meter.evaluations / meter.seconds if meter.seconds else 0.0
            most = min(self.remaining, max(CHUNK_SECONDS * rate, least))
            started = self.seconds
            report = block(most, meter.best, self._target)
            self._take(report, started)
            self._check_end()
            if report.finished:
                return
            if not report.evaluations:
                raise BudgetExhausted

    @contextmanager
    def descent(self) -> Iterator[Descent]:
        """Keep what is evaluated inside as one descent of this run, and say how it ended.

        For methods that descend from several starts of their own: how many ends agree is what a
        run can tell of its optimum. The method sets `converged`.
        """
        self._descent = descent = Descent()
        self.meter.starts.descents.append(descent)
        try:
            yield descent
            descent.finished = True
        finally:
            self._descent = None

    def ended(
        self, start: float, end: float, *, converged: bool = True, finished: bool = True
    ) -> None:
        """Keep a descent that `descent` cannot enclose, since its steps were made between others'.

        `start` and `end` are losses over all rows, `start` math.inf where it was not looked at on
        all of them. A descent that came back to an optimum ended at the loss of that one.
        """
        self.meter.starts.ended(start, end, converged=converged, finished=finished)

    def dropped(self) -> None:
        """Keep a descent that came to its end on fewer rows, where a known optimum is no worse."""
        self.meter.starts.dropped += 1

    def screened(self, configurations: int) -> None:
        """Count configurations that were looked at to choose from which to descend."""
        self.meter.starts.screened += configurations

    @property
    def agreement(self) -> Agreement:
        """How the ends of the descents so far agree on the best loss so far.

        Where it is `enough`, a method may stop.
        """
        return self.meter.starts.agreement(self.best)

    def stop(self) -> None:
        """Read the clocks for the last time, and look at what was not looked at yet."""
        self.meter.seconds = self.seconds
        self.meter.cpu_seconds = self._clock.cpu() - self._cpu
        self._check_box()

    @property
    def _least_squares(self) -> LeastSquaresProblem:
        if not isinstance(self._problem, LeastSquaresProblem):
            raise TypeError(
                f"problem {self._problem.name} gives no residuals; choose a method that needs "
                "only losses (optimizer=miho_qn), or make it a LeastSquaresProblem"
            )
        return self._problem

    def _check_open(self) -> None:
        self._check_end()
        if self.meter.evaluations >= self._limit:
            raise BudgetExhausted

    def _check_end(self) -> None:
        """End the run between two evaluations; a full count ends it only at the next one."""
        if self.interrupted:
            raise RunInterrupted
        if self.meter.seconds >= self._deadline or self.meter.best <= self._target:
            raise BudgetExhausted

    def _chunk(self, rows: int, cost: float) -> int:
        """Rows to evaluate before the next look at the clock, within the evaluations left."""
        meter = self.meter
        if rows > 1:
            rate = meter.evaluations / meter.seconds if meter.seconds > 0 else 0.0
            rows = min(rows, max(1, int(CHUNK_SECONDS * rate / cost)))
        if not self.affords(rows * cost):
            rows = int(self.remaining / cost)
            rows += self.affords((rows + 1) * cost)
        return rows

    def _count_outside(self, rows: Array) -> None:
        """Count the rows outside of the box; of a compiled block only those that improve.

        Many at once, since looking at ten costs as much as looking at a thousand.
        """
        if rows.shape[1:] != self._box[0].shape:
            raise ValueError(
                f"configurations have the shape {rows.shape}; expected (n, {len(self.space)})"
            )
        self._unchecked.append(rows.copy())
        self._rows_unchecked += len(rows)
        if self._rows_unchecked >= CHECKED_AT_ONCE:
            self._check_box()

    def _check_box(self) -> None:
        if self._unchecked:
            rows = np.concatenate(self._unchecked)
            within = (rows >= self._box[0]) & (rows <= self._box[1])
            self.meter.outside += len(rows) - int(np.count_nonzero(within.all(axis=1)))
            self._unchecked, self._rows_unchecked = [], 0

    def _losses(self, rows: Array, fidelity: float) -> Array:
        """The problem's losses; +inf, with its reason counted, for a row that has none."""
        try:
            losses = np.asarray(self._problem.loss(_read_only(rows), fidelity))
            if losses.shape == (len(rows),) and losses.dtype.kind in "fiu":
                return self._usable(losses.astype(float))
            reason = f"not one real number a row: {losses.dtype} of shape {losses.shape}"
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 -- whatever else a model raises is a rejected value
            reason = f"{type(error).__name__}: {error}"
        if len(rows) == 1:
            self.meter.reject(reason)
            return np.array([math.inf])
        return np.concatenate([self._losses(row[None], fidelity) for row in rows])

    def _usable(self, losses: Array) -> Array:
        """The losses with +inf in place of every value that is not a finite number."""
        finite = np.isfinite(losses)
        if np.logical_and.reduce(finite):  # a third of the time of finite.all()
            return losses
        for value, count in Counter(losses[~finite].tolist()).items():
            self.meter.reject(f"{NOT_FINITE} {value}", count)
        return np.where(finite, losses, math.inf)

    def _record(self, rows: Array, losses: Array, cost: float, started: float) -> None:
        """Count the rows and keep their improvements."""
        least = np.minimum.reduce(losses)
        if self._descent is not None and cost == 1.0:
            self._descent.see(losses[0], least)
        if cost == 1.0 and least < self.meter.best:
            lower = losses < np.minimum.accumulate(np.append(self.meter.best, losses[:-1]))
            improving = np.flatnonzero(lower)
            found, thetas = losses[improving], rows[improving]
        else:
            improving, found, thetas = NOWHERE, NONE, rows[:0]
        self._keep((improving + 1).astype(float), found, thetas, losses.size * cost, started)

    def _take(self, block: Block, started: float) -> None:
        """Count what compiled code did, and keep its improvements."""
        for reason, count in block.rejected.items():
            if count:
                self.meter.reject(reason, count)
        if block.losses.size:
            self._count_outside(block.thetas)
        self._keep(block.at, block.losses, block.thetas, block.evaluations, started)

    def _keep(
        self, at: Array, losses: Array, thetas: Array, evaluations: float, started: float
    ) -> None:
        """Count evaluations, record the improvements among them and hold the clock meanwhile.

        `at` (k,) counts the evaluations up to each improvement. The clock is taken to run evenly,
        so each improvement has its own time.
        """
        meter = self.meter
        meter.seconds = now = self._clock.wall() - self._wall
        if at.size:
            meter.cpu_seconds = self._clock.cpu() - self._cpu
            per_evaluation = (now - started) / evaluations
            for count, loss, theta in zip(at.tolist(), losses.tolist(), thetas, strict=True):
                meter.trace.add(
                    self._after(count),
                    now - per_evaluation * (evaluations - count),
                    meter.cpu_seconds,
                    loss,
                    theta,
                )
            meter.best = meter.trace.loss[-1]
            self._wall = self._clock.wall() - now
            self._cpu = self._clock.cpu() - meter.cpu_seconds
        self._spend(evaluations)
        if self._observer is not None and now - self._observed >= OBSERVE_SECONDS:
            self._observed = now
            cpu = self._clock.cpu()
            self._observer(self)
            self._cpu += self._clock.cpu() - cpu
            self._wall = self._clock.wall() - now

    def _spend(self, evaluations: float) -> None:
        """Count what was allowed: a sum of fractions is beyond the limit by its rounding only."""
        self.meter.evaluations = min(self._after(evaluations), self._limit)

    def _after(self, evaluations: float) -> float:
        """The count after so many more, which does not depend on the blocks that they came in.

        On rows of data it is a whole number of them, divided once: sums of fractions would differ
        in their last bits.
        """
        count = self.meter.evaluations + evaluations
        if self.rows is None:
            return count
        rows = count * self.rows
        whole = round(rows)
        near = abs(rows - whole) <= OFF_A_ROW + ROUNDED * rows
        return whole / self.rows if near else count


def _read_only(array: Array) -> Array:
    """A view that a problem cannot edit: the method still works with what it asked."""
    view = array.view()
    view.flags.writeable = False
    return view


def _real(values: Array) -> Array:
    """The values as an array; raises TypeError unless they are real numbers."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"not real numbers: {array.dtype} of shape {array.shape}")
    return array
