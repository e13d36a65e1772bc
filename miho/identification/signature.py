"""Names by which numba and its linker tell the compiled code of one model from another's.

Numba's cache knows a function by its name, its closure and its file; the linker knows it by its
name alone. A function compiled around a model therefore carries a digest of the model's formulas
and of all code that they are compiled with: without it two models, compiled in two processes and
read from the cache by a third, would be taken for each other, and an edited model for the old one.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import TypeVar, cast

from miho.models import elementary
from miho.models.expression import Formula
from miho.optim import climb

Function = TypeVar("Function", bound=Callable[..., object])

COMPILED_WITH = (elementary.__file__, climb.__file__)


def signature_of(formulas: Sequence[Formula], d: int, file: str) -> str:
    """16 hexadecimal digits for these formulas of d parameters, compiled by the code in `file`."""
    known = hashlib.sha256(str(d).encode())
    for formula in formulas:
        code = formula.__code__
        cells = [cell.cell_contents for cell in formula.__closure__ or ()]
        known.update(code.co_code + repr((code.co_consts, code.co_names, cells)).encode())
        known.update(_text(code.co_filename))
    for path in (*COMPILED_WITH, file, str(Path(file).parent / "fused.py")):
        known.update(_text(path))
    return known.hexdigest()[:16]


def signed(signature: str) -> Callable[[Function], Function]:
    """A decorator that puts the signature into a function's name."""

    def sign(function: Function) -> Function:
        function.__qualname__ += f".{signature}"
        return function

    return sign


def signed_copy(formula: Formula, signature: str) -> Formula:
    """A copy of the formula under a name of its own; the original stays as it is."""
    copy = FunctionType(
        formula.__code__, formula.__globals__, formula.__name__, None, formula.__closure__
    )
    return cast(Formula, signed(signature)(copy))


@cache
def _text(path: str) -> bytes:
    return Path(path).read_bytes() if Path(path).is_file() else b""
