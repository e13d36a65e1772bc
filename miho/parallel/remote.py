"""Code that runs in a worker: a function that was sent once is called at many arguments."""

from __future__ import annotations

import contextlib
import pickle
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

MOST_SHARED = 64
"""Functions with their data that a process keeps; the least recently used are dropped first."""


@dataclass(frozen=True)
class Answer:
    """Result of a call in a worker.

    Attributes
    ----------
    value : object
        The value of the function.
    seconds : float
        Duration of the call [s].
    raised : Raised or None
        The exception of the function.
    lacks : bool
        Whether the process lacks the function.
    unloadable : str or None
        The reason why the process cannot load the function, in one line.
    """

    value: Any = None
    seconds: float = 0.0
    raised: Raised | None = None
    lacks: bool = False
    unloadable: str | None = None


@dataclass(frozen=True)
class Raised:
    """An exception as the name of its class and its message, since it may not be picklable.

    `of_machine` marks a failure of the machine, not of the model, that may be temporary: out of
    memory, or a missing file. `overdue` marks a call that exceeded the time limit.
    """

    name: str
    message: str
    of_machine: bool = False
    overdue: bool = False

    @classmethod
    def of(cls, error: BaseException) -> Raised:
        """Description of an exception, even if converting it to text fails."""
        try:
            message = str(error)
        except Exception:  # noqa: BLE001 -- any error of the exception's __str__
            message = "(it has no message)"
        chain = [error, error.__cause__, error.__context__]
        machine = any(isinstance(link, MemoryError | OSError) for link in chain)
        return cls(type(error).__name__, message, machine)

    @property
    def line(self) -> str:
        """Name and message in one line."""
        return f"{self.name}: {' '.join(self.message.split())}"

    def as_error(self) -> ValueError:
        """A ValueError whose class has the same name, with the same message."""
        kind: type[ValueError] = type(self.name, (ValueError,), {})
        return kind(self.message)


shared: OrderedDict[str, Any] = OrderedDict()
"""Functions by their token. The process that owns a function has it from the start."""


def work(token: str, pickled: bytes | None, argument: Any) -> Answer:
    """Call the function of a token; `pickled` contains the function if this process may lack it."""
    if pickled is not None and token not in shared:
        try:
            shared[token] = pickle.loads(pickled)  # noqa: S301 -- from the process that starts this one
        except Exception as error:  # noqa: BLE001 -- for example, a module is not installed here
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
    except Exception as error:  # noqa: BLE001 -- the caller gets any exception
        return Answer(seconds=time.perf_counter() - started, raised=Raised.of(error))
    return Answer(value, time.perf_counter() - started)
