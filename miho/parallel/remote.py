"""What runs in a worker: a function that was sent once, at many arguments."""

from __future__ import annotations

import contextlib
import pickle
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

MOST_SHARED = 64
"""So many functions with their data are kept in a process; those that were not used for longest are
sent again if needed."""


@dataclass(frozen=True)
class Answer:
    """What a call gave, and how many seconds it took; or what it `raised`, or that the process
    `lacks` the function, or in one line why it cannot load it."""

    value: Any = None
    seconds: float = 0.0
    raised: Raised | None = None
    lacks: bool = False
    unloadable: str | None = None


@dataclass(frozen=True)
class Raised:
    """An exception by the name of its class and its message: itself, it may not be picklable.

    One `of_machine` is no property of a model: want of memory, or of a file, may be over later. One
    `overdue` took longer than the limit.
    """

    name: str
    message: str
    of_machine: bool = False
    overdue: bool = False

    @classmethod
    def of(cls, error: BaseException) -> Raised:
        """What is told of an exception, even of one that cannot say anything itself."""
        try:
            message = str(error)
        except Exception:  # noqa: BLE001 -- of the exception's own making
            message = "(it has no message)"
        chain = [error, error.__cause__, error.__context__]
        machine = any(isinstance(link, MemoryError | OSError) for link in chain)
        return cls(type(error).__name__, message, machine)

    @property
    def line(self) -> str:
        """Name and message in one line."""
        return f"{self.name}: {' '.join(self.message.split())}"

    def as_error(self) -> ValueError:
        """An error of the same name and message, whose class is made here."""
        kind: type[ValueError] = type(self.name, (ValueError,), {})
        return kind(self.message)


shared: OrderedDict[str, Any] = OrderedDict()
"""Functions by their token; in the process that owns them from the start."""


def work(token: str, pickled: bytes | None, argument: Any) -> Answer:
    """Call the function of a token, which comes `pickled` if this process lacked it before."""
    if pickled is not None and token not in shared:
        try:
            shared[token] = pickle.loads(pickled)  # noqa: S301 -- by the process that starts this one
        except Exception as error:  # noqa: BLE001 -- such as a module that is not installed here
            return Answer(unloadable=Raised.of(error).line)
        while len(shared) > MOST_SHARED:
            shared.popitem(last=False)
    function: Callable[[Any], Any] | None = shared.get(token)
    if function is None:
        return Answer(lacks=True)
    with contextlib.suppress(KeyError):  # another thread has dropped it meanwhile
        shared.move_to_end(token)
    started = time.perf_counter()
    try:
        value = function(argument)
    except Exception as error:  # noqa: BLE001 -- whatever it raises goes to who called it
        return Answer(seconds=time.perf_counter() - started, raised=Raised.of(error))
    return Answer(value, time.perf_counter() - started)
