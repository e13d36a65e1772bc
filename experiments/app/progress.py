"""Progress of a run on a terminal, off its clock."""

from __future__ import annotations

import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from numba.core import event
from tqdm import tqdm

from miho.optim import Budget, Oracle
from miho.optim.pace import Pace

REFRESH_SECONDS = 1.0
WORTH_TELLING = 2.0
"""Seconds from which a user wonders what a compilation is doing."""
COLUMNS, ROWS = 80, 24
"""Of a terminal that does not tell its own."""


class Observer(Protocol):
    """Called with the oracle about ten times a second."""

    def __call__(self, oracle: Oracle) -> None:
        """Show where the run stands."""


def spent(budget: Budget, evaluations: float, seconds: float) -> tuple[float, float]:
    """The share of the budget that is spent, by the limit that is nearer, and the seconds left.

    The seconds are the most that are left, at the speed so far; math.inf without a limit or before
    the first evaluation.
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
    """A bar that fills with the budget and shows the best error; in a log a line each ten seconds.

    Of a method that makes descents also how many agree: with enough of them some end by themselves.
    Before, for how long numba has been compiling what is not in its cache.
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
                error = f"{math.sqrt(max(0.0, oracle.best)):.5g} {unit}"
            agreement = oracle.agreement
            n, kind = agreement.finished, "brackets" if oracle.meter.starts.brackets else "descents"
            agreeing = f", {agreement.agreeing} of {n} {kind} agree" if n else ""
            line = (
                f"{title}: {error}{agreeing}, {oracle.evaluations:,.0f} evaluations, "
                f"{oracle.meter.seconds:.1f} s{pace.words(oracle)}"
            )
            if bar.disable:
                print(line, file=sys.stderr, flush=True)
            bar.set_description_str(line)

        log = iter([f"{title}: compiling, once on this machine"])

        def compiling(seconds: float | None) -> None:
            if bar.disable:
                for line in log:  # the first time
                    print(line, file=sys.stderr, flush=True)
                return
            stage = "" if seconds is None else f": compiling, once on this machine, {seconds:.0f} s"
            bar.set_description_str(f"{title}{stage}")

        with _watched(compiling):
            yield observe


class _Compilation(event.Listener):  # type: ignore[misc]
    """Since when numba has been compiling, one function within another and one after the other."""

    def __init__(self) -> None:
        self.depth, self.since, self.ended = 0, -math.inf, -math.inf

    def on_start(self, event: Any) -> None:
        """Called by numba."""
        now = time.perf_counter()
        if not self.depth and now - self.ended > REFRESH_SECONDS:
            self.since = now
        self.depth += 1

    def on_end(self, event: Any) -> None:
        """Called by numba."""
        self.depth -= 1
        self.ended = time.perf_counter()


@contextmanager
def _watched(show: Callable[[float | None], None]) -> Iterator[None]:
    """Show each second for how long numba has been compiling, from some seconds on; None after."""
    compilation, finished = _Compilation(), threading.Event()

    def watch() -> None:
        visible = False
        while not finished.wait(REFRESH_SECONDS):
            seconds = time.perf_counter() - compilation.since
            if compilation.depth and seconds >= WORTH_TELLING:
                show(seconds)
                visible = True
            elif visible:
                show(None)
                visible = False

    thread = threading.Thread(target=watch, daemon=True)
    with event.install_listener("numba:compile", compilation):
        thread.start()
        try:
            yield
        finally:
            finished.set()
            thread.join()


@contextmanager
def at_work(title: str) -> Iterator[Callable[[str], None]]:
    """Give a function to call with the name of each stage, shown with its seconds once a second.

    A thread shows them, so that a stage that takes long is seen to be alive; silent if not on a
    terminal.
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
    """Columns and rows of the terminal; None where tqdm reads them, which fails at a size of 0."""
    try:
        has_size = os.get_terminal_size(sys.stderr.fileno()).columns > 0
    except (OSError, ValueError, AttributeError):
        has_size = True
    return (None, None) if has_size else (COLUMNS, ROWS)
