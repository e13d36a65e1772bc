"""Progress of a run on a terminal, outside the time that the run measures."""

import math
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm

from miho.identification.line_wrapping import with_unit
from miho.optim import Budget, Oracle
from miho.optim.pace import Pace

REFRESH_SECONDS = 1.0
COLUMNS, ROWS = 80, 24
"""Size of a terminal that does not report one."""


Observer = Callable[[Oracle], None]
"""A function that is called about ten times a second to show the progress of a run."""


def spent(budget: Budget, evaluations: float, seconds: float) -> tuple[float, float]:
    """Return the used share of the budget, by the nearer limit, and the largest remaining seconds.

    The seconds follow from the speed so far; they are math.inf without a limit or if only
    evaluations are limited and none has ended.
    """
    share, seconds_left = 0.0, math.inf
    if budget.seconds is not None:
        share, seconds_left = seconds / budget.seconds, budget.seconds - seconds
    if budget.evaluations is not None and evaluations:
        share = max(share, evaluations / budget.evaluations)
        seconds_left = min(seconds_left, seconds * (budget.evaluations / evaluations - 1))
    return min(share, 1.0), max(seconds_left, 0.0)


@contextmanager
def progress(title: str, budget: Budget, unit: str) -> Iterator[Observer]:
    """Show the used budget and the best error in a bar, or in a log by a line each ten seconds.

    For a method with several descents it also shows how many agree; some methods stop if enough
    agree.
    """
    limited = budget.evaluations is not None or budget.seconds is not None
    layout = "{percentage:3.0f}% |{bar}| {desc}" if limited else "{desc}"
    columns, rows = _size()
    pace = Pace(budget)
    with tqdm(
        total=1.0, desc=title, leave=False, disable=None, bar_format=layout,
        ncols=columns, nrows=rows,
    ) as bar:  # fmt: skip

        def observe(oracle: Oracle) -> None:
            pace.update(oracle)
            if bar.disable and not pace.line_due():
                return
            bar.n = spent(budget, oracle.evaluations, oracle.meter.seconds)[0]
            error = "no value yet"
            if math.isfinite(oracle.best):
                error = with_unit(f"{math.sqrt(max(0.0, oracle.best)):.5g}", unit)
            agreement = oracle.starts.agreement(oracle.best)
            n, kind = agreement.finished, "brackets" if oracle.meter.starts.brackets else "descents"
            agreeing = f", {agreement.agreeing} of {n} {kind} agree" if n else ""
            line = (
                f"{title}: {error}{agreeing}, {oracle.evaluations:,.0f} evaluations, "
                f"{oracle.meter.seconds:.1f} s{pace.words(oracle)}"
            )
            if bar.disable:
                print(line, file=sys.stderr, flush=True)
            bar.set_description_str(line)

        yield observe


@contextmanager
def at_work(title: str) -> Iterator[Callable[[str], None]]:
    """Yield a function to call with the name of each stage, and show the stage and its seconds.

    A thread refreshes the line once a second, so that a long stage is seen to be alive. Nothing is
    shown if stderr is not a terminal.
    """
    finished = threading.Event()
    layout = f"{title}: {{desc}}{{elapsed}}"
    columns, rows = _size()
    with tqdm(leave=False, disable=None, bar_format=layout, ncols=columns, nrows=rows) as bar:

        def show_stage(stage: str) -> None:
            bar.set_description_str(f"{stage} ", refresh=False)

        def refresh() -> None:
            while not finished.wait(REFRESH_SECONDS):
                bar.refresh()

        thread = threading.Thread(target=refresh, daemon=True)
        if not bar.disable:
            thread.start()
        try:
            yield show_stage
        finally:
            finished.set()
            if thread.is_alive():
                thread.join()


def _size() -> tuple[int | None, int | None]:
    """Columns and rows for tqdm; None if tqdm can read them, which fails at a size of 0."""
    try:
        has_size = os.get_terminal_size(sys.stderr.fileno()).columns > 0
    except (OSError, ValueError, AttributeError):
        has_size = True
    return (None, None) if has_size else (COLUMNS, ROWS)
