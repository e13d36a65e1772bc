"""An alarm for methods that do not reach their next evaluation."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Iterator
from types import FrameType

PATIENCE = 60.0
"""CPU seconds that a method may compute between two evaluations, and seconds that it may wait."""
IDLE = 0.01
"""A method that computes for less than this share of the time is waiting; even a busy machine gives
it more."""


class NoEvaluation(BaseException):
    """A method makes no evaluations. Not an Exception, which a method might catch."""


@contextlib.contextmanager
def patience() -> Iterator[None]:
    """Context that raises NoEvaluation in a method that does not reach its next evaluation.

    It may compute for PATIENCE seconds of its CPU time, so that a busy machine makes no difference,
    or wait for as many seconds of wall time without computing. The context has no effect outside of
    the main thread, because only that handles signals, and on systems without interval timers.
    """
    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or not hasattr(signal, "setitimer"):
        yield
        return

    # Two timers: one for the process's CPU seconds, and one for wall seconds.
    messages: list[str] = []

    def give_up(reason: str) -> None:
        messages.append(f"{reason} without an evaluation")
        raise NoEvaluation(messages[0])

    def on_computing(number: int, frame: FrameType | None) -> None:
        give_up(f"it computed for {PATIENCE:g} CPU seconds")

    last_cpu = time.process_time()

    def on_waiting(number: int, frame: FrameType | None) -> None:
        nonlocal last_cpu
        cpu = time.process_time()
        idle, last_cpu = cpu - last_cpu < IDLE * PATIENCE, cpu
        if idle:
            give_up(f"it waited for {PATIENCE:g} seconds")

    # Set them, and restore the previous handlers at the end.
    handlers = {signal.SIGVTALRM: on_computing, signal.SIGALRM: on_waiting}
    previous = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    _set_timers(PATIENCE)
    try:
        yield
    finally:
        _set_timers(0.0)
        for number, handler in previous.items():
            signal.signal(number, handler)
        if messages:  # it was raised in a run, which caught it and failed
            raise NoEvaluation(messages[0])


def restart_patience() -> None:
    """Restart both timers at an evaluation, if they are running."""
    if hasattr(signal, "setitimer") and signal.getitimer(signal.ITIMER_VIRTUAL)[0]:
        _set_timers(PATIENCE)


def _set_timers(seconds: float) -> None:
    for timer in (signal.ITIMER_VIRTUAL, signal.ITIMER_REAL):
        signal.setitimer(timer, seconds, seconds)
