"""The oracle: the only access of a method to a problem, which counts and records evaluations."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from miho.compiled import Block
from miho.optim.distribution import Distribution
from miho.optim.meter import (
    Budget,
    BudgetExhausted,
    Clock,
    Meter,
    RunInterrupted,
    UnusableValueError,
)
from miho.optim.problem import Problem, Traits, part_of
from miho.optim.recorder import Recorder
from miho.optim.space import Space
from miho.optim.trace import Trace
from miho.optim.usable_values import UsableValues
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.parallel import Evaluations

NO_LOSS = np.array([math.inf])
NO_LOSSES = np.empty(0)


class Oracle:
    """Evaluates a problem for one run: within its budget, and with every evaluation recorded.

    `minimize` creates it and passes it to `Optimizer.run`. A call evaluates a batch in order and
    returns losses; every improvement is recorded at its evaluation. Values that are not finite are
    returned as +inf and never become the best.

    Parameters
    ----------
    problem : Problem
        The problem to evaluate.
    budget : Budget
        Limits of the run.
    space : Space, optional
        Space of the run with its common initial configurations; by default the problem's space.
    meter : Meter, optional
        Counts of an earlier part of the run, to continue it.
    observer : callable, optional
        Called with the oracle about ten times a second, off the clock of the method.
    clock : Clock, optional
        Wall and CPU time.
    evaluations : Evaluations, optional
        Workers and evaluation log.

    Attributes
    ----------
    traits : Traits
        Properties of the problem, for example its number of rows and its linear parameters.
    state : object
        State of a resumable method, set by the method.
    interrupted : bool
        Once set, the next evaluation raises RunInterrupted.
    workers : Distribution
        Begins evaluations ahead, and knows how many to ask for at a time.
    starts : Starts
        Records descents; their agreement is the evidence for an optimum.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> import miho
    >>> @dataclass(frozen=True)
    ... class Grid(miho.Optimizer):
    ...     n: int = 5
    ...     def run(self, oracle, rng):
    ...         low, high = oracle.space.low, oracle.space.high
    ...         for k in range(self.n):
    ...             oracle((low + (high - low) * k / (self.n - 1))[None])
    >>> class Square(miho.Problem):
    ...     name, space = "square", miho.Space((miho.Parameter("a", "", -1, 1),))
    ...     def loss(self, thetas, fidelity=1.0):
    ...         return thetas[:, 0] ** 2
    >>> miho.minimize(Grid(), Square()).theta
    array([0.])
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
    ) -> None:
        self.budget = budget
        self.space = problem.space if space is None else space
        self.meter = Meter() if meter is None else meter
        self.starts = self.meter.starts
        self.state: Any = None
        self.interrupted = False
        self._evaluations = evaluations
        self._values = UsableValues(problem, self.meter.reject)
        self.traits = Traits(problem)
        self.starts.rounding = self.traits.resolution
        if evaluations is not None:
            evaluations.check = self._check_interrupt
        self._limit = math.inf if budget.evaluations is None else budget.evaluations
        self.workers = Distribution(problem, self.traits, evaluations, self.meter, self._limit)
        self._deadline = math.inf if budget.seconds is None else budget.seconds
        self._target = -math.inf if budget.target is None else budget.target
        observe = None if observer is None else partial(observer, self)
        self._recorder = Recorder(  # last, because its clock starts here
            self.meter, self.space, self._limit, problem.rows, clock or Clock(), observe
        )

    if not TYPE_CHECKING:

        def __getattr__(self, name):
            from miho.moved import PARTS_OF_ORACLE

            now = f"; it is oracle.{PARTS_OF_ORACLE[name]} now" if name in PARTS_OF_ORACLE else ""
            raise AttributeError(f"Oracle has no attribute {name!r}{now}")

    @property
    def evaluations(self) -> float:
        """Full evaluations so far; at a lower fidelity each counts as the problem's `cost`."""
        return self.meter.evaluations

    @property
    def seconds(self) -> float:
        """Seconds on the clock of the method, without set-up and recording."""
        return self._recorder.seconds

    @property
    def remaining(self) -> float:
        """Evaluations left, math.inf without a limit."""
        return self._limit - self.meter.evaluations

    @property
    def best(self) -> float:
        """Smallest finite loss so far, math.inf before the first."""
        return self.meter.best

    @property
    def trace(self) -> Trace:
        """Improvements so far."""
        return self.meter.trace

    def __call__(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Evaluate the losses of a batch of configurations.

        Parameters
        ----------
        thetas : ndarray of shape (n, d)
            Configurations, in the units of the space.
        fidelity : float, optional
            Fraction of the data to use, in (0, 1].

        Returns
        -------
        ndarray of shape (n,)
            Losses; +inf for unusable values.

        Raises
        ------
        BudgetExhausted
            At the end of the budget.
        """
        self._check_open()
        if not 0 < fidelity <= 1:
            raise ValueError(f"fidelity is {fidelity!r}; expected a fraction above 0, at most 1")
        cost = self.traits.cost(fidelity)
        unfinished = self.meter.unfinished
        losses = np.array(unfinished) if unfinished else NO_LOSSES
        n = len(thetas)
        begun = n == 1 or self._evaluations is None
        try:
            while losses.size < n:
                if not begun and self.workers.spreads:
                    self.workers.ahead(thetas[losses.size :], fidelity)
                    begun = True
                rows = thetas[losses.size :]
                rows = rows[: self._recorder.chunk(len(rows), cost)]
                if not len(rows):
                    raise BudgetExhausted
                started = self.seconds
                self._recorder.count_outside(rows)
                chunk = self._values.losses(rows, fidelity)
                self._recorder.losses(rows, chunk, cost, started)
                losses = np.concatenate((losses, chunk)) if losses.size else chunk
                self._check_end()
        except BaseException:
            unfinished[:] = losses.tolist()
            raise
        if unfinished:
            unfinished.clear()
        return losses

    def affords(self, evaluations: float) -> bool:
        """Whether the budget covers this number of further evaluations, up to rounding."""
        return self._recorder.affords(evaluations)

    def residuals(self, theta: Array, fidelity: float = 1.0, *, goes_on: bool = False) -> Array:
        """Evaluate the residuals of one configuration.

        A run ends before an evaluation, never between an evaluation and the use of its value. With
        `goes_on` the evaluation is a part of the previous one: it is made even if the run is over,
        unless the budget does not cover it.

        Parameters
        ----------
        theta : ndarray of shape (d,)
            Configuration in units.
        fidelity : float, optional
            Fraction of the rows to use, in (0, 1].
        goes_on : bool, optional
            Whether this continues the previous evaluation.

        Returns
        -------
        ndarray of shape (m,)
            Residuals. They are returned unchanged if they are not finite.

        Raises
        ------
        UnusableValueError
            If the problem raises.
        BudgetExhausted
            At the end of the budget.
        """
        part, cost = part_of(fidelity), self.traits.cost(fidelity)
        if not goes_on:
            self._check_open()
        if not self.affords(cost):
            raise BudgetExhausted
        started = self.seconds
        self._recorder.count_outside(theta[None])
        try:
            residuals, loss = self._values.residuals(theta, *part)
        except UnusableValueError:
            self._recorder.losses(theta[None], NO_LOSS, cost, started)
            raise
        self._recorder.losses(theta[None], loss, cost, started)
        return residuals

    def residual_rows(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Residuals (k, m) of the first k of several configurations (n, d): k evaluations.

        k is limited by the time between two checks of the clock, and by the budget; raises
        BudgetExhausted if it is 0. A row is NaN if the problem raises.
        """
        part, cost = part_of(fidelity), self.traits.cost(fidelity)
        self._check_open()
        if self.workers.spreads:
            self.workers.ahead(thetas, fidelity, "residuals")
        rows = thetas[: self._recorder.chunk(len(thetas), cost)]
        if not len(rows):
            raise BudgetExhausted
        started = self.seconds
        self._recorder.count_outside(rows)
        residuals, losses = self._values.residual_rows(rows, *part)
        self._recorder.losses(rows, losses, cost, started)
        return residuals

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Derivatives of the residuals (m, d) at one configuration (d,) in units.

        Costs `traits.jacobian_cost` evaluations. Raises BudgetExhausted if the budget does not
        cover them, and UnusableValueError if the problem raises or a derivative is not finite.
        """
        part, cost = part_of(fidelity), self.traits.cost(fidelity)
        cost *= self.traits.jacobian_cost
        self._check_open()
        if not self.affords(cost):
            raise BudgetExhausted
        try:
            jacobian = self._values.jacobian(theta, *part)
        except UnusableValueError:
            self._recorder.derivatives(cost)
            raise
        self._recorder.derivatives(cost)
        return jacobian

    def spend(self, block: Callable[[float, float, float], Block], least: float) -> None:
        """Run a compiled kernel in blocks of about 20 ms until it is done.

        `block(most, best, target)` makes at most `most` evaluations and reports them, with each
        improvement at its evaluation. It must leave the state of the method complete, so that the
        next call continues from it. `least` is the number of evaluations that its next step may
        need; a budget below it is exhausted. Raises like an evaluation at the end of the run.
        """
        meter = self.meter
        while True:
            self._check_open()
            most = min(self.remaining, max(self._recorder.at_once, least))
            started = self.seconds
            report = block(most, meter.best, self._target)
            self._recorder.block(report, started)
            self._check_end()
            if report.finished:
                return
            if not report.evaluations and most >= self.remaining:  # else Ctrl-C ended the block
                raise BudgetExhausted

    def stop(self) -> None:
        """Read the clocks for the last time, after the last evaluation."""
        self._recorder.stop()
        if self.workers.usage is not None:
            self.workers.usage.of_blocks(self._recorder.evaluated, self._recorder.evaluating)

    def _check_open(self) -> None:
        self._check_end()
        if self.meter.evaluations >= self._limit:
            raise BudgetExhausted

    def _check_end(self) -> None:
        """End the run between two evaluations; a full count ends it at the next evaluation only."""
        self._check_interrupt()
        if self.meter.seconds >= self._deadline or self.meter.best <= self._target:
            raise BudgetExhausted

    def _check_interrupt(self) -> None:
        if self.interrupted:
            raise RunInterrupted
