"""Lines on stderr about a long search."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable

from miho.fitting.search import title
from miho.identification.curve_fit import CurveFit
from miho.identification.line_wrapping import with_unit
from miho.optim import Budget, Optimizer, Oracle, RunRecord
from miho.optim.pace import Pace
from miho.parallel.worth import is_expensive, span

FIRST = 2.0
"""Seconds before the first line of progress."""
LIMIT = "budget=miho.Budget(seconds=60) limits it to a minute"


def pace_line(
    problem: CurveFit,
    method: Optimizer,
    budget: Budget | None,
    began: float | None = None,
    limitable: bool = True,
) -> Callable[[Oracle], None]:
    """An observer that reports a long search on stderr after FIRST seconds and every ten seconds.

    The first line says how to limit a `limitable` search without a budget. The search `began` at
    this time of `time.monotonic`, now if it is None.
    """
    budget = budget or Budget()
    pace = Pace(budget, FIRST, began)
    endless = budget.evaluations is None and budget.seconds is None
    stops = f"; {type(method).__name__} stops by itself" + f"; {LIMIT}" * limitable
    hints = iter([stops] if endless else [])

    def observe(oracle: Oracle) -> None:
        pace.update(oracle)
        if pace.line_due():
            reasons = oracle.meter.rejected.most_common(1)
            error = "no value yet" + "".join(f" ({reason})" for reason, _ in reasons)
            if math.isfinite(oracle.best):
                error = with_unit(f"error {max(0.0, oracle.best) ** 0.5:.5g}", problem.unit)
            say(
                f"{title(problem)}: {error} after {oracle.evaluations:,.0f} evaluations, "
                f"{oracle.meter.seconds:,.0f} s{pace.words(oracle)}{next(hints, '')}"
            )

    return observe


def interrupted(run: RunRecord, resumable: bool = True) -> KeyboardInterrupt:
    """The exception for a search, `resumable` with a journal, that Ctrl-C interrupted."""
    each = run.seconds / max(1.0, run.evaluations)
    if not (resumable and is_expensive(each)):
        return KeyboardInterrupt("the search was interrupted")
    return KeyboardInterrupt(
        f"the search was interrupted; an evaluation takes {span(each)}: with journal='FILE' none "
        "is lost, and the same call continues"
    )


def say(text: str) -> None:
    """Write a line to stderr."""
    sys.stderr.write(f"miho: {text}\n")
    sys.stderr.flush()
