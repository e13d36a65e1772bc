"""Functions of the simulated car that numba compiles; the first call imports numba.

Numba's cache on disk knows a function by its own file and name. It does not see an edit of another
file, from which the function takes what it calls. The name of a compiled function therefore ends in
a digest of all files that compiled code here is taken from.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar, cast

import miho.quantities

Function = TypeVar("Function", bound=Callable[..., Any])


class MissingNumbaError(ModuleNotFoundError):
    """What is simulated needs numba, which is not installed."""

    def __init__(self) -> None:
        super().__init__("driving needs numba: pip install 'miho[driving]'", name="numba")


def compiled(function: Function) -> Function:
    """A decorator: the function is compiled at its first call, or read from the cache on disk.

    It may call functions that are a `part`. A call raises MissingNumbaError without numba.
    """

    @wraps(function)
    def call(*arguments: Any) -> Any:
        return (_compiled.get(function) or _compile(function))(*arguments)

    return cast(Function, call)


def part(function: Function) -> Function:
    """A decorator: compiled functions may call the function. Called from Python it is Python's."""
    _parts.append(function)
    return function


_compiled: dict[Callable[..., Any], Any] = {}
_parts: list[Callable[..., Any]] = []
"""Functions that numba has not been shown yet."""
_compiling = Lock()


def _compile(function: Callable[..., Any]) -> Any:
    with _compiling:
        if function not in _compiled:
            try:
                from numba import njit
                from numba.extending import register_jitable
            except ModuleNotFoundError as error:
                if error.name != "numba":
                    raise
                raise MissingNumbaError from None
            while _parts:
                register_jitable(error_model="numpy")(_parts.pop())
            function.__qualname__ += f".{_digest()}"
            _compiled[function] = njit(cache=True, nogil=True, error_model="numpy")(function)
    return _compiled[function]


@cache
def _digest() -> str:
    """16 hexadecimal digits of the files that compiled code is taken from."""
    files = [*sorted(Path(__file__).parent.glob("*.py")), Path(miho.quantities.__file__)]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]
