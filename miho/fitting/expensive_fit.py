"""A fit of an expensive model: workers, and the journal of evaluations, also as a start."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from typing import TYPE_CHECKING

import numpy as np

from miho.fitting.progress import say
from miho.fitting.search import title
from miho.identification.constraints import free_values
from miho.identification.curve_fit import CurveFit
from miho.models.model import expensive_leaves
from miho.models.spread import SpreadModel
from miho.optim.spread import open_evaluations
from miho.parallel.errors import NoWorkersLeft

if TYPE_CHECKING:
    from miho.parallel import Evaluations, Workers

JournalPath = str | os.PathLike[str] | None
CLOSE = 1e-9
"""Relative difference between values of a tied parameter that counts as rounding."""
JOURNAL = "journal"
"""The name of the start at the best configuration in the journal."""


def as_begun(
    problem_of: Callable[[bool], CurveFit], journal: JournalPath, limit: float | None
) -> CurveFit:
    """The problem of a fit, in the state that its journal recorded if there is one.

    The problem is not evaluated if it is known to be expensive, because a journal exists, or if a
    `limit` applies to each evaluation.
    """
    if journal is None:
        return problem_of(limit is not None)
    if not isinstance(journal, str | os.PathLike):
        raise ValueError(f"journal is {journal!r}; expected a file, for example 'model.journal'")
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


def check_start(start: str, journal: JournalPath) -> None:
    """Raise ValueError for a named start that is not "journal", or without a journal."""
    if start != JOURNAL:
        raise ValueError(f"start is {start!r}; expected numbers by name, or {JOURNAL!r}")
    if journal is None:
        raise ValueError(f"start is {JOURNAL!r}; expected a file as journal as well")


def best_known(problem: CurveFit) -> dict[str, float]:
    """The configuration in the journal with the smallest loss, without priors.

    The evaluations of `problem` are journaled. Raises ValueError if no configuration in the journal
    satisfies bounds and constraints, and for a model with several parts.
    """
    leaves = expensive_leaves(problem.model)
    if len(leaves) != 1 or not isinstance(leaves[0], SpreadModel):
        raise ValueError(
            f"start: expected a single model whose evaluations are journaled, got {problem.name}; "
            "give numbers"
        )
    thetas, outputs = leaves[0].known(*problem.inputs)
    for k in np.argsort(problem.losses_of(outputs), kind="stable") if len(thetas) else ():
        values = dict(zip(leaves[0].parameters, thetas[k].tolist(), strict=True))
        if _is_allowed(problem, values):
            return values
    raise ValueError(
        f"start: the journal has no configuration of {problem.name} within the bounds with a "
        "finite value; give numbers, or no start to search"
    )


def _is_allowed(problem: CurveFit, values: dict[str, float]) -> bool:
    """Whether parameters can have these values within bounds, ties and constraints."""
    ties, space = problem.model.ties, problem.space
    try:
        theta = free_values(space, ties, values)
    except (KeyError, ValueError):  # its ties differ
        return False
    if ties is not None:
        whole = dict(zip(ties.names, ties.values(theta[None])[0], strict=True))
        if not all(math.isclose(whole[name], values[name], rel_tol=CLOSE) for name in values):
            return False
    return bool(((theta >= space.low) & (theta <= space.high)).all())
