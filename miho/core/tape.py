"""Tapes of operations on blocks of rows, and the two machines that run them.

The machine in C (`miho/core/*.c`) works on 256 rows at a time, whose temporaries stay in the cache,
and gives the same bits on every processor. The NumPy machine works on all rows at once. It is the
reference of the tests, and the fallback if the library was installed without a C compiler.
"""

from __future__ import annotations

import sys
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache, cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from miho.quantities import Array

TINY, HUGE = 1e-100, 1e300
"""Smallest base of a logarithm, and limit of the operation BOUND."""


class Instruction(NamedTuple):
    """An operation, the registers that it reads, and the registers that it writes.

    The second operand of the operations from ADD_S to S_DIV is a scalar.
    """

    operation: str
    operands: tuple[int, ...]
    results: tuple[int, ...]


class TapeError(ValueError):
    """Raised for an invalid tape: it reads or writes undefined places, or is too long."""


def _where(condition: Any, x: Any, y: Any) -> Any:
    return np.where(condition != 0, x, y)


def _truth(comparison: Callable[..., Any]) -> Callable[..., Any]:
    """A comparison that returns 1 and 0."""
    return lambda x, y: comparison(x, y) * 1.0


OPERATIONS: Mapping[str, Callable[..., Any]] = {
    "ADD": np.add, "SUB": np.subtract, "MUL": np.multiply, "DIV": np.divide,
    "ADD_S": np.add, "MUL_S": np.multiply, "SUB_S": np.subtract, "DIV_S": np.divide,
    "S_SUB": lambda x, s: s - x, "S_DIV": lambda x, s: s / x,
    "NEG": np.negative, "SQUARE": np.square, "SQRT": np.sqrt, "ABS": np.abs, "SIGN": np.sign,
    "COPY": np.positive, "MIN": np.minimum, "MAX": np.maximum,
    "BOUND": lambda x: np.minimum(np.maximum(x, -HUGE), HUGE),
    "EXP": np.exp, "EXPM1": np.expm1,
    "LOG": np.log, "LOG1P": np.log1p, "LOG10": np.log10, "LOG2": np.log2,
    "SIN": np.sin, "COS": np.cos, "SINCOS": lambda x: (np.sin(x), np.cos(x)), "TAN": np.tan,
    "ASIN": np.arcsin, "ACOS": np.arccos, "ATAN": np.arctan, "ATAN2": np.arctan2,
    "HYPOT": np.hypot, "SINH": np.sinh, "COSH": np.cosh, "TANH": np.tanh,
    "ASINH": np.arcsinh, "ACOSH": np.arccosh, "ATANH": np.arctanh,
    "LOG_PARTS": lambda x: (np.log(np.abs(x)), np.zeros_like(x)),
    "FLOOR_PARTS": lambda high, low: (np.maximum(high, np.log(TINY)), low),
    "POWER": lambda x, y, high, low: np.power(x, y),
    "GT": _truth(np.greater), "GE": _truth(np.greater_equal),
    "LT": _truth(np.less), "LE": _truth(np.less_equal),
    "EQ": _truth(np.equal), "NE": _truth(np.not_equal),
    "AND": np.multiply, "OR": lambda x, y: x + y - x * y, "NOT": lambda x: 1.0 - x,
    "WHERE": _where,
}  # fmt: skip
"""The operations in the order of their numbers (`miho/core/tape.h`).  The operations from ADD_S to
S_DIV take a scalar; true is 1 and false 0. LOG_PARTS returns the logarithm of |x| as a sum of two
numbers, FLOOR_PARTS the same for values of at least TINY, and POWER computes a power from the parts
of its base, so that a power and its derivatives need one logarithm."""
IN_NUMPY = "miho: formulas run in NumPy, which is slower: {}\n"
NOT_BUILT = (
    "the library was installed without a C compiler; install one, for example gcc, then miho again"
)
STALE = (
    "miho/core was built from other sources; build it again by python setup.py build_ext --inplace "
    "--force"
)
NUMBER = {name: k for k, name in enumerate(OPERATIONS)}
WITH_SCALAR = {"ADD_S", "MUL_S", "SUB_S", "DIV_S", "S_SUB", "S_DIV"}


@cache
def machine() -> Any:
    """The machine in C, None if it was not built, or was built from other sources.

    Without it a line on stderr says so, once per process.
    """
    try:
        import miho.core._machine as built
    except ImportError:
        sys.stderr.write(IN_NUMPY.format(NOT_BUILT))
        return None
    fits = "sources" in vars(built) and checksum() in (None, built.sources())
    if fits and built.operations() == tuple(OPERATIONS):
        return built
    sys.stderr.write(IN_NUMPY.format(STALE))
    return None


def checksum() -> int | None:
    """The checksum of the sources in C, None if there are none to read; `setup.py` has the same."""
    try:
        texts = c_sources(Path(__file__).parent).values()
    except OSError:
        return None
    return zlib.crc32(b"".join(texts)) if texts else None


def c_sources(folder: Path) -> dict[str, bytes]:
    """Texts of the C files in a folder by name.

    Hidden files, for example an editor's locks, and line endings do not count.
    """
    paths = sorted(folder.glob("[!.]*.[ch]"))
    return {path.name: path.read_bytes().replace(b"\r\n", b"\n") for path in paths}


@dataclass(frozen=True, eq=False)
class Tape:
    """Operations that compute results from input columns and parameters.

    Registers hold rows: the `inputs`, then the `results`, then work registers. Scalars are the
    `constants`, the `parameters`, then the results of `once`, computed once for all rows. `fills`
    are pairs of a register with the same scalar in all rows, and this scalar.
    """

    inputs: int
    results: int
    registers: int
    parameters: int
    scalars: int
    constants: tuple[float, ...]
    once: tuple[Instruction, ...]
    code: tuple[Instruction, ...]
    fills: tuple[tuple[int, int], ...]

    def __getstate__(self) -> dict[str, Any]:
        """The fields alone; the form in the machine is created again."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def evaluate(self, thetas: Array, X: Array) -> Array:
        """Results (n, results, N) of parameter rows (n, d) at input columns X (p, N)."""
        out = np.empty((len(thetas), self.results, X.shape[1]))
        if self.in_machine is None:
            for theta, values in zip(thetas, out, strict=True):
                for value, row in zip(self.by_numpy(theta, X), values, strict=True):
                    row[:] = value
        elif out.size:
            thetas, X = _doubles(thetas), _doubles(X)
            machine().evaluate(self.in_machine, thetas, X, out)
        return out

    def mean_squares(self, thetas: Array, X: Array, y: Array, first: int) -> Array:
        """Mean squares (n,) of the single result minus y (m,), over the first m rows of X (p, N).

        The machine sums blocks of rows; the first block has `first` rows.
        """
        out = np.empty(len(thetas))
        if self.in_machine is None:
            for i, theta in enumerate(thetas):
                with np.errstate(all="ignore"):
                    out[i] = np.mean((self.by_numpy(theta, X[:, : y.size])[0] - y) ** 2)
        elif out.size:
            columns, data = _doubles(X), _doubles(y)
            machine().mean_squares(self.in_machine, _doubles(thetas), columns, data, first, out)
        return out

    def by_numpy(self, theta: Array, X: Array) -> list[Any]:
        """Results at all rows by NumPy, scalars if they are the same in all rows."""
        registers: list[Any] = [*X, *[None] * (self.registers - len(X))]
        scalars: list[Any] = [*self.constants, *theta]
        scalars += [None] * (self.scalars - len(scalars))
        with np.errstate(all="ignore"):
            _run(self.once, scalars, scalars)
            for register, scalar in self.fills:
                registers[register] = scalars[scalar]
            _run(self.code, registers, scalars)
        return registers[self.inputs : self.inputs + self.results]

    @cached_property
    def in_machine(self) -> Any:
        """The tape in the machine, None without it; raises TapeError for an invalid tape."""
        return None if machine() is None else self.at_level(-1)

    def at_level(self, level: int) -> Any:
        """The tape in the machine for a level of processor instructions, -1 for the highest."""
        counts = [
            self.inputs, self.results, self.registers, len(self.constants), self.parameters,
            self.scalars, len(self.once), len(self.code), len(self.fills),
        ]  # fmt: skip
        try:
            return machine().tape(
                np.array(counts, dtype=np.int32), _numbers([*self.once, *self.code]),
                np.array(self.constants), np.array(self.fills, dtype=np.int32), level,
            )  # fmt: skip
        except (ValueError, OverflowError, KeyError, TypeError) as error:
            raise TapeError(str(error)) from None


def _run(code: Sequence[Instruction], registers: list[Any], scalars: list[Any]) -> None:
    for name, operands, results in code:
        with_scalar = name in WITH_SCALAR
        values = [(scalars if with_scalar and i else registers)[k] for i, k in enumerate(operands)]
        outcome = OPERATIONS[name](*values)
        outcomes = outcome if len(results) > 1 else (outcome,)
        for register, value in zip(results, outcomes, strict=True):
            registers[register] = value


def _numbers(code: Sequence[Instruction]) -> np.ndarray[Any, np.dtype[np.int32]]:
    """Instructions as numbers for the machine: operation, four operands, two results."""
    rows = np.zeros((len(code), 7), dtype=np.int32)
    for row, (name, operands, results) in zip(rows, code, strict=True):
        row[0] = NUMBER[name]
        row[1 : 1 + len(operands)] = operands
        row[5 : 5 + len(results)] = results
    return rows


def _doubles(array: Array) -> Array:
    return np.ascontiguousarray(array, dtype=float)
