"""A fit of an expensive model: workers, and the journal of evaluations."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from typing import TYPE_CHECKING

from miho.fitting.progress import say
from miho.fitting.search import title
from miho.identification.curve_fit import CurveFit
from miho.optim.spread import open_evaluations
from miho.parallel.errors import NoWorkersLeft

if TYPE_CHECKING:
    from miho.parallel import Evaluations, Workers

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
                say(f"{title(problem)}: {book.status} ({journal})")
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
            say(str(evaluations.usage))
