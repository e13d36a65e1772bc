"""A problem whose evaluations are made by workers, or kept in a journal."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from typing import Any

import numpy as np

from miho.optim.problem import LeastSquaresProblem, Problem
from miho.parallel import (
    Evaluated,
    Evaluations,
    Journal,
    StaleJournalError,
    Workers,
    open_pool,
)
from miho.quantities import Array
from miho.validate import positive

WHOLE = 1.0


JournalFile = str | os.PathLike[str] | Journal | None
"""A file for the evaluations of a problem, or the journal that was opened of it."""


class SpreadProblem(Problem):
    """Another problem, whose losses are evaluated elsewhere; all else is as it says itself."""

    def __init__(self, problem: Problem, evaluations: Evaluations) -> None:
        self.name, self.space, self.rows = problem.name, problem.space, problem.rows
        self.rounding, self.resolution = problem.rounding, problem.resolution
        self.noise, self.row_inputs = problem.noise, problem.row_inputs
        self.problem, self._evaluations = problem, evaluations
        self._tasks: dict[tuple[str, float], Evaluated] = {}

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Losses (n,) of parameter rows (n, d)."""
        return self._task("loss", fidelity)(thetas)

    def cost(self, fidelity: float) -> float:
        """As the problem says."""
        return self.problem.cost(fidelity)

    def _task(self, kind: str, fidelity: float) -> Evaluated:
        """What evaluates one kind of value."""
        if (kind, fidelity) not in self._tasks:
            rows = partial(_KINDS[kind], self.problem, fidelity)
            name = f"{kind} {fidelity!r}"
            self._tasks[kind, fidelity] = self._evaluations.function(name, rows)
        return self._tasks[kind, fidelity]


class SpreadLeastSquares(SpreadProblem, LeastSquaresProblem):
    """A least-squares problem, whose residuals and derivatives are evaluated elsewhere as well."""

    def __init__(self, problem: LeastSquaresProblem, evaluations: Evaluations) -> None:
        super().__init__(problem, evaluations)
        self.linear, self.order = problem.linear, problem.order
        self.jacobian_cost = problem.jacobian_cost

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Residuals (m,) of one configuration (d,)."""
        return np.asarray(self._task("residuals", fidelity)(theta[None])[0])

    def residual_rows(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Residuals (n, m) of several configurations (n, d)."""
        return self._task("residuals", fidelity)(thetas)

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Derivatives of the residuals, (m, d), at one configuration (d,)."""
        return np.asarray(self._task("jacobian", fidelity)(theta[None])[0])


@contextmanager
def spread_problem(
    problem: Any,
    workers: Workers | Evaluations = None,
    evaluation_limit: float | None = None,
    journal: JournalFile = None,
) -> Iterator[tuple[Any, Evaluations | None]]:
    """The problem whose evaluations are made by workers or kept in a journal, and what makes them.

    The problem itself, and None, without either; itself too where it is never dear.
    """
    with open_evaluations(problem, workers, evaluation_limit, journal) as evaluations:
        yield problem if evaluations is None else problem.spread(evaluations), evaluations


@contextmanager
def open_evaluations(
    problem: Problem,
    workers: Workers | Evaluations = None,
    evaluation_limit: float | None = None,
    journal: JournalFile = None,
) -> Iterator[Evaluations | None]:
    """What makes the evaluations of a problem, and of others with its models and data.

    Evaluations that are open already are used as they are. Raises JournalError for a journal that
    cannot be used, and for one of a model that has changed as soon as that shows;
    UncheckedJournalError where the model fails for a reason that may pass.
    """
    if isinstance(workers, Evaluations):
        yield workers
        return
    if evaluation_limit is not None:
        positive("evaluation_limit", evaluation_limit)
    with ExitStack() as stack:
        pool = stack.enter_context(open_pool(workers, evaluation_limit))
        if journal is not None and not isinstance(journal, Journal):
            journal = stack.enter_context(closing(Journal(journal, problem)))
        if pool is None and journal is None:
            yield None
            return
        evaluations = Evaluations(pool, journal, limited=evaluation_limit is not None)
        with closing(evaluations):
            try:
                yield evaluations
            except StaleJournalError as reason:
                raise reason.error from None


def spread(problem: Problem, evaluations: Evaluations) -> Problem:
    """A problem whose evaluations are made by these."""
    if isinstance(problem, LeastSquaresProblem):
        return SpreadLeastSquares(problem, evaluations)
    return SpreadProblem(problem, evaluations)


def _losses(problem: Any, fidelity: float, thetas: Array) -> Array:
    losses = np.asarray(problem.loss(thetas, *_part(fidelity)))
    if losses.shape != (len(thetas),) or losses.dtype.kind not in "fiu":
        raise ValueError(f"not one real number a row: {losses.dtype} of shape {losses.shape}")
    return losses


def _residuals(problem: Any, fidelity: float, thetas: Array) -> Array:
    return np.array([problem.residuals(theta, *_part(fidelity)) for theta in thetas])


def _jacobians(problem: Any, fidelity: float, thetas: Array) -> Array:
    return np.array([problem.jacobian(theta, *_part(fidelity)) for theta in thetas])


def _part(fidelity: float) -> tuple[float, ...]:
    return () if fidelity == WHOLE else (fidelity,)


_KINDS = {"loss": _losses, "residuals": _residuals, "jacobian": _jacobians}
