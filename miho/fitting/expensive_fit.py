"""A fit of an expensive model: workers, lines of progress, and the journal of evaluations."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from typing import TYPE_CHECKING

from miho.identification.curve_fit import CurveFit
from miho.optim import Budget, Optimizer, Oracle, RunRecord
from miho.optim.pace import Pace
from miho.optim.spread import open_evaluations
from miho.parallel.errors import NoWorkersLeft
from miho.parallel.usage import span
from miho.parallel.worth import is_expensive

if TYPE_CHECKING:
    from miho.parallel import Evaluations, Workers

FIRST = 2.0
"""Seconds before the first line of progress."""
LIMIT = "budget=miho.Budget(seconds=60) limits it to a minute"
JournalPath = str | os.PathLike[str] | None


def as_begun(
    problem_of: Callable[[bool], CurveFit], journal: JournalPath, limit: float | None
) -> CurveFit:
    """The problem of a fit, in the state that its journal recorded if there is one.

    The problem is not evaluated if it is known to be expensive, because a journal exists, or if a
    `limit` applies to each evaluation.
    """
    if journal is None:
        return problem_of(limit is not None)
    from miho.parallel import calls_of

    calls = calls_of(journal)
    return problem_of(calls is not None or limit is not None).called(calls or ())


@contextmanager
def expensive_fit(
    problem: CurveFit,
    workers: Workers = None,
    evaluation_limit: float | None = None,
    journal: JournalPath = None,
) -> Iterator[Evaluations | None]:
    """The evaluator of a fit, for search and descents; None if this process evaluates directly.

    Lines on stderr report the evaluations that the journal supplies and the use of workers. After
    a Ctrl-C the exception names the journal and the number of evaluations in it.
    """
    with ExitStack() as stack:
        book = None
        if journal is not None:
            from miho.parallel import Journal

            book = stack.enter_context(closing(Journal(journal, problem)))
            if book.status:
                _say(f"{title(problem)}: {book.status} ({journal})")
        evaluations = stack.enter_context(
            open_evaluations(problem, workers, evaluation_limit, book)
        )
        try:
            yield evaluations
        except NoWorkersLeft as reason:
            raise ValueError(f"{problem.name}: {reason}") from None
        except KeyboardInterrupt as error:
            if book is None or not len(book):
                raise
            raise KeyboardInterrupt(
                f"{len(book):,} evaluations are kept in {journal}; the same call continues from "
                "them"
            ) from error
        if evaluations is not None and evaluations.workers > 1:
            _say(str(evaluations.usage))


def spread(problem: CurveFit, evaluations: Evaluations | None) -> CurveFit:
    """The problem with its evaluations made by `evaluations`, if given."""
    return problem if evaluations is None else problem.spread(evaluations)


def title(problem: CurveFit) -> str:
    """The name of a problem in lines on stderr: the name of its model, "model" for a lambda."""
    name = problem.model.name or "model"
    return "model" if name == "<lambda>" else name


def pace_line(
    problem: CurveFit, method: Optimizer, budget: Budget | None
) -> Callable[[Oracle], None]:
    """An observer that reports a long search on stderr after FIRST seconds and every ten seconds.

    The first line says how to limit a search without a budget.
    """
    budget = budget or Budget()
    pace = Pace(budget, FIRST)
    endless = budget.evaluations is None and budget.seconds is None
    hints = iter([f"; {type(method).__name__} stops by itself; {LIMIT}"] if endless else [])

    def observe(oracle: Oracle) -> None:
        pace.update(oracle)
        if pace.line_due():
            error = "no value yet"
            if math.isfinite(oracle.best):
                error = f"error {max(0.0, oracle.best) ** 0.5:.5g} {problem.unit}".rstrip()
            _say(
                f"{title(problem)}: {error} after {oracle.evaluations:,.0f} evaluations, "
                f"{oracle.meter.seconds:,.0f} s{pace.words(oracle)}{next(hints, '')}"
            )

    return observe


def interrupted(run: RunRecord) -> KeyboardInterrupt:
    """The exception for a search that was interrupted by Ctrl-C."""
    each = run.seconds / max(1.0, run.evaluations)
    if not is_expensive(each):
        return KeyboardInterrupt("the search was interrupted")
    return KeyboardInterrupt(
        f"the search was interrupted; an evaluation takes {span(each)}: with journal='FILE' none "
        "is lost, and the same call continues"
    )


def _say(text: str) -> None:
    sys.stderr.write(f"miho: {text}\n")
    sys.stderr.flush()
