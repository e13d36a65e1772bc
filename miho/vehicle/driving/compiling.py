"""Compilation of the simulated car's functions by numba, which the first call imports.

Numba's cache on disk identifies a function by its file and name, and does not notice edits of
called functions in other files. The name of a compiled function therefore ends with a digest of all
files with compiled code.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from functools import cache, wraps
from numbers import Real
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar, cast

import numpy as np

import miho.quantities

Function = TypeVar("Function", bound=Callable[..., Any])


class MissingNumbaError(ModuleNotFoundError):
    """Error for a simulation without numba."""

    def __init__(self) -> None:
        super().__init__("driving needs numba: pip install 'miho[vehicle]'", name="numba")


def compiled(function: Function) -> Function:
    """Decorate a function to be compiled at its first call, or read from the cache on disk.

    It may call functions decorated with `part`. A call raises MissingNumbaError without numba.
    """

    @wraps(function)
    def call(*arguments: Any) -> Any:
        return (_compiled.get(function) or _compile(function))(*arguments)

    return cast(Function, call)


def part(function: Function) -> Function:
    """Decorate a function that compiled functions may call; Python calls run uncompiled."""
    _parts.append(function)
    return function


def record_of(numbers: Mapping[str, Any]) -> Any:
    """Return a record with the numbers among the values of a mapping, in its order."""
    values = {name: v for name, v in numbers.items() if isinstance(v, Real)}
    dtype = np.dtype([(name, np.float64) for name in values])
    return np.array(tuple(values.values()), dtype=dtype)[()]


_compiled: dict[Callable[..., Any], Any] = {}
_parts: list[Callable[..., Any]] = []
"""Functions that are not yet registered with numba."""
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
    """Return 16 hexadecimal digits of a digest of the files with compiled code."""
    files = [*sorted(Path(__file__).parent.glob("*.py")), Path(miho.quantities.__file__)]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]
