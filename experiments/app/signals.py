"""Signals that end a command; after the first one, the runs stop and keep their best so far."""

import contextlib
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import FrameType

HANG_UP = getattr(signal, "SIGHUP", None)
"""Signal of a closed terminal; Windows has none."""
STOPPING = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGUSR1", "SIGHUP")
    if hasattr(signal, name)
)


class Stopped(KeyboardInterrupt):
    """A signal ended the command; `number` is its number."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@dataclass
class Stop:
    """The signal that asked to stop, and its time."""

    number: int | None = None
    at: float = 0.0
    repeated: bool = False

    def overdue(self, seconds: float) -> bool:
        """Whether the runs have had this time to stop."""
        return self.number is not None and time.monotonic() > self.at + seconds


def name_of(number: int) -> str:
    """Name of a signal, such as SIGINT."""
    return signal.Signals(number).name


def ignores_hang_up() -> bool:
    """Whether this process ignores SIGHUP, the signal of a closed terminal, as under nohup."""
    return HANG_UP is None or signal.getsignal(HANG_UP) is signal.SIG_IGN


@contextlib.contextmanager
def stopping_signal() -> Iterator[Callable[[], int | None]]:
    """Context in which SIGTERM and a closed terminal interrupt like Ctrl-C.

    Yields a function that returns the number of the first signal, or None. Python writes the number
    of each handled signal to a socket, so it is known even if a library swallows the interrupt.
    """
    signal.signal(signal.SIGTERM, _as_interrupt)
    if HANG_UP is not None and not ignores_hang_up():
        signal.signal(HANG_UP, _as_interrupt)
    numbers, write = socket.socketpair()
    with numbers, write:
        for end in (numbers, write):
            end.setblocking(False)
        before = signal.set_wakeup_fd(write.fileno(), warn_on_full_buffer=False)

        def first() -> int | None:
            with contextlib.suppress(BlockingIOError):
                arrived = numbers.recv(1 << 12)
                return next((n for n in arrived if n in STOPPING), None)
            return None

        try:
            yield first
        finally:
            signal.set_wakeup_fd(before)


def _as_interrupt(number: int, frame: FrameType | None) -> None:
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in background jobs of a shell
        raise KeyboardInterrupt
    signal.raise_signal(signal.SIGINT)


@contextlib.contextmanager
def stopping(interrupt: Callable[[], None]) -> Iterator[Stop]:
    """Context in which the first signal calls `interrupt`, and the second raises `Stopped`."""
    stop = Stop()

    def on_signal(number: int, frame: FrameType | None) -> None:
        if stop.number is not None:
            raise Stopped(number)
        stop.number, stop.at = number, time.monotonic()
        interrupt()

    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    handled = [number for number in STOPPING if number != HANG_UP or not ignores_hang_up()]
    before = {number: signal.signal(number, on_signal) for number in handled}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
