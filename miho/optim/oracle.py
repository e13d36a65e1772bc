"""One run's metered view of a problem: the only door between a method and the loss."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from miho.compiled import Block, Kernel
from miho.optim.evidence import Agreement
from miho.optim.meter import (
    Arrivals,
    Budget,
    BudgetExhausted,
    Clock,
    Meter,
    RunInterrupted,
    UnusableValueError,
)
from miho.optim.problem import Problem
from miho.optim.recorder import Recorder
from miho.optim.space import Space
from miho.optim.structure import MOST, has_structure
from miho.optim.trace import Descent, Trace
from miho.optim.usable_values import UsableValues, read_only
from miho.parallel import Ahead, Evaluations
from miho.parallel.usage import Usage
from miho.quantities import Array

CHUNK_SECONDS = 0.02
"""Seconds of evaluations between two looks at the clock."""
Kind = Literal["loss", "residuals", "jacobian"]
NO_LOSS = np.array([math.inf])
NO_LOSSES, NOWHERE = np.empty(0), np.empty(0, np.int64)


class Oracle:
    """Makes every evaluation of one run, within its budget, and has it recorded.

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
        evaluations: Evaluations | None = None,
        replay: Arrivals | None = None,
    ) -> None:
        self.budget = budget
        self.space = problem.space if space is None else space
        self.rows = problem.rows
        self.meter = Meter() if meter is None else meter
        self.meter.starts.rounding = max(problem.rounding, problem.resolution)
        self.state: Any = None
        self.interrupted = False
        self._problem, self._evaluations = problem, evaluations
        self._values = UsableValues(problem, self.meter.reject)
        self._replay = replay
        if evaluations is not None:
            evaluations.check = self._check_interrupt
        self._limit = math.inf if budget.evaluations is None else budget.evaluations
        self._deadline = math.inf if budget.seconds is None else budget.seconds
        self._target = -math.inf if budget.target is None else budget.target
        self._descent: Descent | None = None
        self._recorder = Recorder(  # last of all, since its clock starts here
            self.meter,
            self.space,
            self._limit,
            self.rows,
            Clock() if clock is None else clock,
            None if observer is None else partial(observer, self),
        )

    @property
    def evaluations(self) -> float:
        """Full evaluations so far; at a lower fidelity they count what the problem says."""
        return self.meter.evaluations

    @property
    def seconds(self) -> float:
        """Seconds of the method's clock: the run without set-up and recording."""
        return self._recorder.seconds

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
        return self._values.least_squares.linear

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
        losses = np.array(unfinished) if unfinished else NO_LOSSES
        n = len(thetas)
        begun = n == 1 or self._evaluations is None
        try:
            while losses.size < n:
                if not begun and self.spreads:
                    self.ahead(thetas[losses.size :], fidelity)
                    begun = True
                rows = thetas[losses.size : losses.size + self._chunk(n - losses.size, cost)]
                if not len(rows):
                    raise BudgetExhausted
                started = self.seconds
                self._recorder.count_outside(rows)
                chunk = self._values.losses(rows, fidelity)
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
    def workers(self) -> int:
        """How many evaluations a method may have under way at a time.

        One, until it is known that each is worth a worker of its own; from then on as many as there
        are workers, also in a run that is resumed. In a replay as many as in the original.
        """
        arrivals, replay, evaluations = self.meter.arrivals, self._replay, self._evaluations
        if not arrivals.workers:
            count = 0
            if replay is not None:
                count = replay.workers if self.evaluations >= replay.alone else 0
            elif evaluations is not None and evaluations.worth_one:
                count = evaluations.workers
            if count > 1:
                arrivals.workers, arrivals.alone = count, self.evaluations
        at_a_time = max(1, arrivals.workers)
        if evaluations is not None:
            evaluations.usage.at_a_time = at_a_time
        return at_a_time

    @property
    def spreads(self) -> bool:
        """Whether workers make the evaluations of a batch: where it is known that they are dear."""
        return self._evaluations is not None and self._evaluations.spreads

    @property
    def usage(self) -> Usage | None:
        """How the workers are used, None without any."""
        return None if self._evaluations is None else self._evaluations.usage

    @property
    def busy(self) -> int:
        """How many workers have something to do."""
        return 0 if self._evaluations is None else self._evaluations.busy

    def ahead(self, thetas: Array, fidelity: float = 1.0, kind: Kind = "loss") -> Ahead:
        """Have workers begin to evaluate rows (n, d): their losses, residuals or derivatives.

        Nothing is counted or recorded: that is done when they are asked for as without workers.
        Only as many are begun as the budget can pay for.
        """
        cost = self._problem.cost(fidelity) * (self.jacobian_cost if kind == "jacobian" else 1)
        affordable = len(thetas)
        while affordable and not self.affords(affordable * cost):
            affordable = min(affordable - 1, int(self.remaining / cost))
        rows, part = read_only(thetas[:affordable]), () if fidelity == 1.0 else (fidelity,)

        def ask() -> None:
            if kind == "loss" and affordable:
                self._problem.loss(rows, *part)
            elif kind == "residuals" and affordable:
                self._values.least_squares.residual_rows(rows, *part)
            elif kind == "jacobian":
                for theta in rows:
                    self._values.least_squares.jacobian(theta, *part)

        return Ahead([], ask) if self._evaluations is None else self._evaluations.ahead(ask)

    def first_ready(self, needs: Sequence[Ahead]) -> int:
        """The position of the evaluations that workers have ended first; waits for one of them.

        Where workers make none, it is 0; in a run that is a replay, what it was in the original.
        """
        if len(needs) == 1:
            return 0
        positions, position = self.meter.arrivals.positions, 0
        replayed = [] if self._replay is None else self._replay.positions
        if len(positions) < len(replayed):
            position = replayed[len(positions)]
            if not 0 <= position < len(needs):
                raise ValueError(
                    f"replay: arrival {len(positions)} is at position {position} of {len(needs)}; "
                    "expected the arrivals of the same method, problem and seed"
                )
        elif self._evaluations is not None:
            position = self._evaluations.first_ready(needs)
        positions.append(position)
        return position

    @property
    def kernel(self) -> Kernel | None:
        """Fast forms of the problem's loss, for blocks of evaluations (`spend`)."""
        return self._problem.kernel

    @property
    def order(self) -> NDArray[np.intp] | None:
        """Positions of all residuals in the order of a fidelity, None if they stand in it."""
        return self._values.least_squares.order

    @property
    def jacobian_cost(self) -> int:
        """What the derivatives of the residuals cost, in evaluations of the same rows."""
        cost = self._values.least_squares.jacobian_cost
        return len(self.space) if cost is None else cost

    @property
    def rounding(self) -> float:
        """A loss up to this counts as 0: its digits are rounding."""
        return self._problem.rounding

    @property
    def resolution(self) -> float:
        """Losses that differ by no more than this count as equal."""
        return self.meter.starts.rounding

    @property
    def noise(self) -> float:
        """A loss above this is more than the noise of the data explains, as far as is known."""
        return self._problem.noise

    def structured(self, theta: Array) -> bool:
        """Whether residuals at a configuration (d,) have structure that noise has not.

        It takes an evaluation, of long data a part of one, where the inputs of rows are known.
        Residuals that cannot be evaluated are in doubt.
        """
        inputs, rows = self._problem.row_inputs, self.rows
        if not inputs:
            return False
        share = 1.0 if rows is None or rows <= MOST else MOST / rows
        try:
            residuals = self.residuals(theta, share)
        except UnusableValueError:
            return True
        places = np.arange(residuals.size)
        if share < 1 and self.order is not None:
            places = self.order[: residuals.size]
        data = places < inputs[0].size  # not what a prior adds
        return has_structure([x[places[data]] for x in inputs], residuals[data])

    def affords(self, evaluations: float) -> bool:
        """Whether the budget can pay for so many more evaluations, whatever their rounding."""
        return self._recorder.count_after(evaluations) <= self._limit

    def cost(self, fidelity: float) -> float:
        """What one evaluation at a fidelity costs, in full evaluations."""
        return self._problem.cost(fidelity)

    def residuals(self, theta: Array, fidelity: float = 1.0, *, goes_on: bool = False) -> Array:
        """Residuals (m,) of one configuration (d,) in units: one evaluation of so many rows.

        A run ends before an evaluation, never between it and the use of its value. One that
        `goes_on` with the evaluation before it, of which it is a part, is made even if the run is
        over, unless the budget cannot pay for it.

        Raises UnusableValueError if the problem raises; residuals that are not finite are
        returned as they are, for solvers that know what to do with them.
        """
        part, cost = self._part(fidelity)
        if not goes_on:
            self._check_open()
        if not self.affords(cost):
            raise BudgetExhausted
        started = self.seconds
        self._recorder.count_outside(theta[None])
        try:
            residuals, loss = self._values.residuals(theta, *part)
        except UnusableValueError:
            self._record(theta[None], NO_LOSS, cost, started)
            raise
        self._record(theta[None], loss, cost, started)
        return residuals

    def residual_rows(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Residuals (k, m) of the first k of some configurations (n, d): k evaluations.

        As many as fit between two looks at the clock, and as the budget pays for; with none left it
        is exhausted. A row is NaN where the problem raises.
        """
        part, cost = self._part(fidelity)
        self._check_open()
        if self.spreads:
            self.ahead(thetas, fidelity, "residuals")
        rows = thetas[: self._chunk(len(thetas), cost)]
        if not len(rows):
            raise BudgetExhausted
        started = self.seconds
        self._recorder.count_outside(rows)
        residuals, losses = self._values.residual_rows(rows, *part)
        self._record(rows, losses, cost, started)
        return residuals

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Derivatives of the residuals (m, d) at one configuration (d,) in units.

        Costs `jacobian_cost` evaluations; a budget that cannot pay it is exhausted. Raises
        UnusableValueError if the problem raises or a derivative is not finite.
        """
        part, cost = self._part(fidelity)
        cost *= self.jacobian_cost
        self._check_open()
        if not self.affords(cost):
            raise BudgetExhausted
        try:
            jacobian = self._values.jacobian(theta, *part)
        except UnusableValueError:
            self._charge(cost)
            raise
        self._charge(cost)
        return jacobian

    def _charge(self, cost: float) -> None:
        self._recorder.charge(cost)
        self.meter.seconds = self.seconds

    def _part(self, fidelity: float) -> tuple[tuple[float, ...], float]:
        """The arguments by which a problem takes a fidelity, none for all rows, and its cost."""
        if fidelity == 1.0:
            return (), 1.0
        return (fidelity,), self._problem.cost(fidelity)

    def spend(self, block: Callable[[float, float, float], Block], least: float) -> None:
        """Let a kernel evaluate in blocks of some 20 ms until it is done.

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
            self._record_block(report, started)
            self._check_end()
            if report.finished:
                return
            if not report.evaluations:
                raise BudgetExhausted

    @contextmanager
    def descent(self) -> Iterator[Descent]:
        """Record what is evaluated inside as one descent of this run.

        For methods that descend from several starts of their own: how many ends agree is the
        evidence for a run's optimum. The method sets `converged`.
        """
        self._descent = descent = Descent()
        self.meter.starts.descents.append(descent)
        try:
            yield descent
            descent.finished = True
        finally:
            self._descent = None

    def record_descent(
        self,
        start: float,
        end: float,
        *,
        converged: bool = True,
        finished: bool = True,
        theta: Array | None = None,
    ) -> None:
        """Record a descent that `descent` cannot enclose, since other descents' steps lie between.

        `start` and `end` are losses over all rows, `start` math.inf where it was not looked at on
        all of them; `theta` (d,) is where it ended, in units. A descent that came back to an
        optimum ended at the loss and the place of that one.
        """
        self.meter.starts.add(start, end, converged=converged, finished=finished, theta=theta)

    def record_dropped(self) -> None:
        """Record a descent that ended on fewer rows, where a known optimum is no worse."""
        self.meter.starts.dropped += 1

    def record_screened(self, configurations: int) -> None:
        """Record how many configurations were looked at to choose from which to descend."""
        self.meter.starts.screened += configurations

    @property
    def agreement(self) -> Agreement:
        """How the ends of the descents so far agree on the best loss so far.

        Where it is `enough`, a method may stop.
        """
        return self.meter.starts.agreement(self.best)

    def stop(self) -> None:
        """Read the clocks for the last time: no evaluation follows."""
        self._recorder.stop()
        usage, recorder = self.usage, self._recorder
        if usage is not None and usage.each is None and not usage.known and recorder.evaluated:
            usage.here += round(recorder.evaluated)  # in blocks, which nobody else has timed
            usage.each = recorder.evaluating / recorder.evaluated

    def _check_open(self) -> None:
        self._check_end()
        if self.meter.evaluations >= self._limit:
            raise BudgetExhausted

    def _check_end(self) -> None:
        """End the run between two evaluations; a full count ends it only at the next one."""
        self._check_interrupt()
        if self.meter.seconds >= self._deadline or self.meter.best <= self._target:
            raise BudgetExhausted

    def _check_interrupt(self) -> None:
        if self.interrupted:
            raise RunInterrupted

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

    def _record(self, rows: Array, losses: Array, cost: float, started: float) -> None:
        """Record a batch of losses (n,) with its improvements."""
        meter, least = self.meter, np.minimum.reduce(losses)
        if self._descent is not None and cost == 1.0:
            self._descent.see(rows, losses)
        if cost == 1.0 and least < meter.best:
            lower = losses < np.minimum.accumulate(np.append(meter.best, losses[:-1]))
            improving = np.flatnonzero(lower)
            improved, thetas = losses[improving], rows[improving]
        else:
            improving, improved, thetas = NOWHERE, NO_LOSSES, rows[:0]
            if meter.best == math.inf and losses.size:
                meter.note(cost, losses, rows)
        at = (improving + 1).astype(float)
        self._recorder.record(at, improved, thetas, losses.size * cost, started)

    def _record_block(self, block: Block, started: float) -> None:
        """Record what a block did, with its improvements."""
        for reason, count in block.rejected.items():
            if count:
                self.meter.reject(reason, count)
        if block.provisional is not None:
            self.meter.note(*block.provisional)
        if block.losses.size:
            self._recorder.count_outside(block.thetas)  # of a block, only those that improve
        self._recorder.record(block.at, block.losses, block.thetas, block.evaluations, started)
