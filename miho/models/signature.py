"""Names by which numba and its linker tell compiled code from other code of the same name.

Numba's cache knows a function by its name, its closure and its file; the linker knows it by its
name alone. Neither sees an edit in another file, from which the function takes what it calls. A
function that is compiled around a model therefore carries a digest of the model's formulas and of
all code that they are compiled with: without it two models, compiled in two processes and read from
the cache by a third, would be taken for each other, and an edited model for the old one.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar, cast

from miho.models import elementary
from miho.models.expression import Formula

Function = TypeVar("Function", bound=Callable[..., object])


@dataclass(frozen=True)
class Signed:
    """Formulas of one model with their signature, by which alone two of them are equal.

    A cache with these for keys compiles equal formulas once, even if each model makes its own.
    """

    signature: str
    formulas: tuple[Formula, ...] = field(compare=False)

    def copies(self) -> list[Formula]:
        """Copies of the formulas under names of their own; the originals stay as they are."""
        sign = signed(self.signature)
        return [
            cast(Formula, sign(FunctionType(f.__code__, f.__globals__, f.__name__, None,
                                            f.__closure__)))
            for f in self.formulas
        ]  # fmt: skip


def signed_formulas(formulas: tuple[Formula, ...], shape: tuple[int, ...], *files: str) -> Signed:
    """The formulas with a signature; `shape` and the code in `files` are what else is compiled in.

    The signature tells formulas apart by their code, the files it stands in, the values that they
    close over and the numbers and functions among their globals, whose own code counts likewise.
    """
    known = hashlib.sha256(repr((shape, signature_of(*files))).encode())
    functions: list[Any] = list(formulas)
    for function in functions:
        code = function.__code__
        held = [cell.cell_contents for cell in function.__closure__ or ()]
        named = [function.__globals__.get(name) for name in code.co_names]
        functions += [
            one for one in (*held, *named) if isinstance(one, FunctionType) and one not in functions
        ]
        held = [one for one in held if not isinstance(one, FunctionType)]
        named = [one for one in named if isinstance(one, int | float | tuple)]
        known.update(code.co_code + repr((code.co_consts, code.co_names, held, named)).encode())
        known.update(_text(code.co_filename))
    return Signed(known.hexdigest()[:16], formulas)


def signature_of(*files: str) -> str:
    """16 hexadecimal digits for the code in these files, with that of the elementary functions."""
    known = hashlib.sha256()
    for path in (elementary.__file__, __file__, *files):
        known.update(_text(path))
    return known.hexdigest()[:16]


def signed(signature: str) -> Callable[[Function], Function]:
    """A decorator that puts the signature into a function's name."""

    def sign(function: Function) -> Function:
        function.__qualname__ += f".{signature}"
        return function

    return sign


@cache
def _text(path: str) -> bytes:
    return Path(path).read_bytes() if Path(path).is_file() else b""
