"""Names by which numba and its linker tell compiled code from other code of the same name.

Numba's cache knows a function by its name, its closure and its file; the linker knows it by its
name alone. Neither sees an edit in another file, from which the function takes what it calls. A
function that calls what stands elsewhere therefore carries a digest of all code that it is compiled
with: without it two models, compiled in two processes and read from the cache by a third, would be
taken for each other, and an edited model for the old one.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import cache, cached_property, update_wrapper
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, Generic, TypeVar

Function = TypeVar("Function", bound=Callable[..., object])


def signature_of(*functions: Callable[..., object], shape: tuple[int, ...] = ()) -> str:
    """16 hexadecimal digits of functions, of all that they call, and of the code of this package.

    Functions are told apart by their code, the files it stands in, the values that they close over
    and the numbers, functions and classes among their globals, whose own code counts likewise.
    """
    digest = hashlib.sha256(_package() + repr(shape).encode())
    queue: list[Any] = list(functions)
    for function in queue:  # which grows
        code = function.__code__
        closed_over = [cell.cell_contents for cell in function.__closure__ or ()]
        names = [*_names(code), *map(str, function.__annotations__.values())]
        values = [function.__globals__.get(name) for name in names]
        # What it calls is read in its turn; a compiled function holds its Python one.
        callees = [getattr(value, "py_func", value) for value in (*closed_over, *values)]
        queue += [f for f in callees if isinstance(f, FunctionType) and f not in queue]
        # What is compiled in: the code, and the values that it closes over or takes from globals.
        constants = [value for value in closed_over if not isinstance(value, FunctionType)]
        numbers = [value for value in values if isinstance(value, int | float | tuple)]
        digest.update(code.co_code + repr((code.co_consts, names, constants, numbers)).encode())
        digest.update(_text(code.co_filename))
        for value in values:
            if isinstance(value, type):  # a record whose fields the code reads
                digest.update(_text(getattr(sys.modules[value.__module__], "__file__", "")))
    return digest.hexdigest()[:16]


def signing(signature: str) -> Callable[[Function], Function]:
    """A decorator that puts the signature into a function's name."""

    def sign(function: Function) -> Function:
        function.__qualname__ += f".{signature}"
        return function

    return sign


class Entry(Generic[Function]):
    """A function that is compiled by numba and cached on disk; numba is imported at the first call.

    The signature is made then too, when all that the function calls is defined. `options` are those
    of numba's `njit`. `function` is the Python function.
    """

    def __init__(self, function: Function, options: Mapping[str, Any]) -> None:
        update_wrapper(self, function)
        self.function, self._options = function, options

    def __call__(self, *arguments: Any) -> Any:
        """Call numba's form."""
        return self.compiled(*arguments)

    @cached_property
    def compiled(self) -> Any:
        """Numba's form of the function."""
        import numba

        sign = signing(signature_of(self.function))
        return numba.njit(cache=True, **self._options)(sign(self.function))


def compiled_when_called(**options: Any) -> Callable[[Function], Entry[Function]]:
    """A decorator as numba's njit, cached on disk; numba is imported at the first call."""
    return lambda function: Entry(function, options)


def _names(code: CodeType) -> Iterator[str]:
    """The global names in a function's code, and in that of the functions inside of it."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


@cache
def _package() -> bytes:
    """A digest of the code of this package."""
    texts = [_text(str(path)) for path in sorted(Path(__file__).parent.glob("*.py"))]
    return hashlib.sha256(b"".join(texts)).digest()


@cache
def _text(path: str) -> bytes:
    return Path(path).read_bytes() if Path(path).is_file() else b""
