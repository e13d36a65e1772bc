"""A problem whose evaluations run on workers or are stored in a journal."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from miho.optim.problem import LeastSquaresProblem, Problem, part_of
from miho.parallel.errors import StaleJournalError
from miho.quantities import Array
from miho.validate import positive

if TYPE_CHECKING:
    from miho.parallel import Evaluated, Evaluations, Journal, Workers


JournalFile: TypeAlias = "str | os.PathLike[str] | Journal | None"
"""A file for the evaluations of a problem, or an open journal."""


class SpreadProblem(Problem):
    """A wrapped problem whose losses are evaluated elsewhere.

    It has the values of the wrapped problem for all attributes in `declared`.
    """

    declared: tuple[str, ...] = (
        "name", "space", "rows", "rounding", "resolution", "noise", "row_inputs", "row_parts",
    )  # fmt: skip

    def __init__(self, problem: Problem, evaluations: Evaluations) -> None:
        vars(self).update({name: getattr(problem, name) for name in self.declared})
        self.problem, self._evaluations = problem, evaluations
        self._tasks: dict[tuple[str, float], Evaluated] = {}

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Losses (n,) of parameter rows (n, d)."""
        return self._task("loss", fidelity)(thetas)

    def cost(self, fidelity: float) -> float:
        """Cost of an evaluation, as for the wrapped problem."""
        return self.problem.cost(fidelity)

    def angles(self, thetas: Array) -> Array:
        """Ends of the range of each angle, as for the wrapped problem."""
        return self.problem.angles(thetas)

    def _task(self, kind: str, fidelity: float) -> Evaluated:
        """Evaluator of one kind of value."""
        if (kind, fidelity) not in self._tasks:
            rows = partial(_KINDS[kind], self.problem, fidelity)
            name = f"{kind} {fidelity!r}"
            self._tasks[kind, fidelity] = self._evaluations.function(name, rows)
        return self._tasks[kind, fidelity]


class SpreadLeastSquares(SpreadProblem, LeastSquaresProblem):
    """A wrapped least-squares problem; residuals and derivatives are also evaluated elsewhere."""

    declared = (*SpreadProblem.declared, "linear", "order", "jacobian_cost")

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
    """Problem whose evaluations run on workers or are stored in a journal, and its evaluations.

    Without workers and journal the result is the problem itself and None. A problem that is never
    expensive is returned unchanged.
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
    """Evaluations of a problem, and of other problems with the same models and data.

    Open evaluations are used unchanged. Raises JournalError if the journal cannot be used, or as
    soon as it turns out that its model has changed; UncheckedJournalError if the model fails for a
    reason that may be temporary.
    """
    if workers is None and evaluation_limit is None and journal is None:
        yield None
        return
    from miho.parallel import Evaluations, Journal, open_pool

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
    """Problem with its evaluations on these workers."""
    if isinstance(problem, LeastSquaresProblem):
        return SpreadLeastSquares(problem, evaluations)
    return SpreadProblem(problem, evaluations)


def _losses(problem: Any, fidelity: float, thetas: Array) -> Array:
    losses = np.asarray(problem.loss(thetas, *part_of(fidelity)))
    if losses.shape != (len(thetas),) or losses.dtype.kind not in "fiu":
        raise ValueError(f"not one real number per row: {losses.dtype} of shape {losses.shape}")
    return losses


def _residuals(problem: Any, fidelity: float, thetas: Array) -> Array:
    return np.array([problem.residuals(theta, *part_of(fidelity)) for theta in thetas])


def _jacobians(problem: Any, fidelity: float, thetas: Array) -> Array:
    return np.array([problem.jacobian(theta, *part_of(fidelity)) for theta in thetas])


_KINDS = {"loss": _losses, "residuals": _residuals, "jacobian": _jacobians}
