"""Formulas as graphs, traced from plain functions and differentiated.

A function of arithmetic and NumPy's elementwise functions is called with symbols in place of
numbers, and returns the graph of its computation. Derivatives of the graph follow by reverse
accumulation (Griewank and Walther, Evaluating Derivatives, 2008, Ch. 3.2).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextvars import ContextVar
from functools import cache
from typing import Any, NoReturn

import numpy as np

MOST = 5000
"""Largest number of operations; compiling a longer formula takes longer than it saves."""
TINY, HUGE = 1e-100, 1e300
"""Bounds that keep derivatives near branch points finite, so that 0 times them is 0."""


class NotAFormulaError(BaseException):  # an `except Exception` of the function does not catch it
    """A function cannot be traced; the trace notes the error in case the function catches it."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        noted = REFUSALS.get()
        if noted is not None:
            noted.append(self)


REFUSALS: ContextVar[list[NotAFormulaError] | None] = ContextVar("refusals", default=None)
"""Errors of the trace in progress."""


def _operator(name: str, swapped: bool = False) -> Callable[..., Any]:
    """Return a method of symbols that creates an operation."""
    if swapped:
        return lambda self, other: operation(name, other, self)
    return lambda *symbols: operation(name, *symbols)


class Symbol:
    """A node of a graph: an argument, a constant, or an operation on symbols.

    `operation` is a name in OPERATIONS with its `arguments`, ARGUMENT with its name, or CONSTANT
    with its number. A symbol has no truth value; a comparison creates a symbol with an operation
    in CONDITION, which `np.where` accepts.
    """

    __slots__ = ("arguments", "operation")

    def __init__(self, operation: str, *arguments: Any) -> None:
        self.operation = operation
        self.arguments = arguments

    @property
    def number(self) -> float | None:
        """Value of a constant, None for other symbols."""
        return self.arguments[0] if self.operation == CONSTANT else None

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **keywords: Any) -> Any:
        name = UFUNCS.get(ufunc.__name__)
        if name is None or method != "__call__" or keywords:
            raise NotAFormulaError(ufunc.__name__)
        return operation(name, *inputs)

    def __array_function__(self, function: Any, types: Any, inputs: Any, keywords: Any) -> Any:
        if function is np.where and len(inputs) == 3 and not keywords:
            return operation("where", *inputs)
        if function is np.clip and len(inputs) == 3 and not keywords:
            return np.minimum(np.maximum(*inputs[:2]), inputs[2])
        raise NotAFormulaError(function.__name__)

    __add__, __radd__ = _operator("add"), _operator("add", swapped=True)
    __sub__, __rsub__ = _operator("subtract"), _operator("subtract", swapped=True)
    __mul__, __rmul__ = _operator("multiply"), _operator("multiply", swapped=True)
    __truediv__, __rtruediv__ = _operator("divide"), _operator("divide", swapped=True)
    __pow__, __rpow__ = _operator("power"), _operator("power", swapped=True)
    __neg__, __pos__, __abs__ = _operator("negative"), _operator("positive"), _operator("absolute")
    __gt__, __ge__ = _operator("greater"), _operator("greater_equal")
    __lt__, __le__ = _operator("less"), _operator("less_equal")
    __eq__, __ne__ = _operator("equal"), _operator("not_equal")
    __and__, __or__ = _operator("logical_and"), _operator("logical_or")
    __invert__ = _operator("logical_not")

    def _refuse(self, *_: object) -> NoReturn:
        raise NotAFormulaError("a symbol has no value")

    def __getattr__(self, name: str) -> NoReturn:
        if name.startswith("__"):  # NumPy and `copy` ask for protocols
            raise AttributeError(name)
        raise NotAFormulaError(f"a symbol has no {name}")

    __bool__ = __array__ = __format__ = __float__ = __int__ = __index__ = __complex__ = _refuse
    __round__ = __trunc__ = __floor__ = __ceil__ = _refuse
    __iter__ = __len__ = __contains__ = __getitem__ = __setitem__ = __delitem__ = _refuse
    __floordiv__ = __mod__ = __divmod__ = __matmul__ = __xor__ = _refuse
    __rfloordiv__ = __rmod__ = __rdivmod__ = __rmatmul__ = __rxor__ = __rand__ = __ror__ = _refuse
    __hash__ = object.__hash__


ARGUMENT, CONSTANT = "argument", "constant"
LOGIC = ("logical_and", "logical_or", "logical_not")
CONDITION = {"greater", "greater_equal", "less", "less_equal", "equal", "not_equal", *LOGIC}
BENDS = {*CONDITION, "sign", "minimum", "maximum", "absolute"}
"""Operations with discontinuous derivatives."""
FINITE = {ARGUMENT, CONSTANT, *CONDITION}  # finite operations: 0 times them is 0


@cache
def argument(name: str) -> Symbol:
    """Return the unique symbol of the argument `name`."""
    return Symbol(ARGUMENT, name)


def constant(value: float) -> Symbol:
    """Return the symbol of a number."""
    return Symbol(CONSTANT, float(value))


def operation(name: str, *arguments: Any) -> Symbol:
    """Return an operation on symbols and numbers, simplified if an argument is 0 or 1."""
    symbols = [_symbol(value) for value in arguments]
    numbers = [symbol.number for symbol in symbols]
    if None not in numbers:
        with np.errstate(all="ignore"):
            value = float(getattr(np, name)(*numbers))
        return constant(value)
    _check_conditions(name, symbols)
    simple = _simplified(name, symbols, numbers)
    if simple is None or (simple.operation in CONDITION and name not in LOGIC):  # 1 times it
        return Symbol(name, *symbols)
    return simple


def _check_conditions(name: str, symbols: Sequence[Symbol]) -> None:
    """Refuse operations for which NumPy treats bools differently from 1 and 0."""
    logical = (symbol.operation in CONDITION or symbol.number in (0, 1) for symbol in symbols)
    if name in LOGIC:
        fitting = all(logical)
    else:
        conditions = all(symbol.operation in CONDITION for symbol in symbols)
        fitting = not conditions and (name != "where" or next(logical))
    if not fitting:
        raise NotAFormulaError(f"{name} does not accept these conditions or numbers")


def _symbol(value: Any) -> Symbol:
    if isinstance(value, Symbol):
        return value
    number = np.asarray(value)
    if number.ndim or number.dtype.kind not in "fiu":
        raise NotAFormulaError(f"expected a number, got {value!r}")
    return constant(float(number))


def _simplified(
    name: str, symbols: Sequence[Symbol], numbers: Sequence[float | None]
) -> Symbol | None:
    """Return a simpler symbol of the same value, None if there is none."""
    if name in ("add", "subtract", "multiply", "divide", "power"):
        (left, right), (a, b) = symbols, numbers
        if (name in ("add", "subtract") and b == 0) or (name != "add" and b == 1):
            return None if name == "subtract" and b == 1 else left
        if (name == "add" and a == 0) or (name == "multiply" and a == 1):
            return right
        other = right if a is not None else left
        if name == "multiply" and 0 in (a, b) and other.operation in FINITE:
            return constant(0.0)
        if other.operation in CONDITION:  # bools have no negative and no square
            return None
        if name == "subtract" and a == 0:
            return operation("negative", right)
        if name == "multiply" and -1 in (a, b):
            return operation("negative", other)
        if name == "power" and b == 2:
            return Symbol("multiply", left, left)
        if name == "power" and b == 0.5:
            return Symbol("sqrt", left)
    if name == "negative" and symbols[0].operation == "negative":
        inner: Symbol = symbols[0].arguments[0]
        return inner
    if name in ("logical_and", "logical_or") and (numbers[0], numbers[1]) != (None, None):
        known, other = symbols if numbers[0] is not None else symbols[::-1]
        return other if known.number == (name == "logical_and") else known
    if name == "where" and (numbers[0] is not None or symbols[1] is symbols[2]):
        return symbols[1] if numbers[0] else symbols[2]
    if name == "where" and numbers[1] is not None and numbers[1] == numbers[2]:
        return symbols[1]
    if name == "square":
        return Symbol("multiply", symbols[0], symbols[0])
    return symbols[0] if name == "positive" else None


Partials = Callable[..., tuple[Any, ...]]


def _power_partials(z: Symbol, a: Symbol, b: Symbol) -> tuple[Any, ...]:
    """Return the partial derivatives of a^b.

    A negative base needs an integer exponent; the sign of z and a selects the derivative.
    """
    above = operation("maximum", operation("absolute", a), TINY)
    if b.number is not None and b.number.is_integer():
        return (b * a ** (b - 1) if b.number else 0.0), constant(0.0)
    sign = operation("sign", z) * operation("sign", a)
    slope = sign + 1 - operation("absolute", sign)  # 1 at a base of 0
    return b * above ** (b - 1) * slope, z * operation("log", above)


def _bounded(value: Any) -> Symbol:
    """Return a partial derivative with an upper bound, so that 0 times it is 0."""
    if isinstance(value, Symbol) and value.operation in (ARGUMENT, CONSTANT):
        return value
    return operation("minimum", operation("maximum", value, -HUGE), HUGE)


def _no_partials(z: Symbol, *arguments: Symbol) -> tuple[int, ...]:
    """Return zeros, the partial derivatives of a step."""
    return (0,) * len(arguments)


OPERATIONS: Mapping[str, tuple[str, Partials]] = {
    "add": ("{} + {}", lambda z, a, b: (1, 1)),
    "subtract": ("{} - {}", lambda z, a, b: (1, -1)),
    "multiply": ("{} * {}", lambda z, a, b: (b, a)),
    "divide": ("{} / {}", lambda z, a, b: (1 / b, _bounded(-z / b))),
    "power": ("{} ** {}", _power_partials),
    "negative": ("-{}", lambda z, a: (-1,)),
    "absolute": ("np.abs({})", lambda z, a: (np.sign(a),)),
    "sign": ("np.sign({})", lambda z, a: (0,)),
    "exp": ("np.exp({})", lambda z, a: (_bounded(z),)),
    "expm1": ("np.expm1({})", lambda z, a: (z + 1,)),
    "log": ("np.log({})", lambda z, a: (_bounded(1 / a),)),
    "log1p": ("np.log1p({})", lambda z, a: (1 / (1 + a),)),
    "log10": ("np.log10({})", lambda z, a: (1 / (math.log(10) * a),)),
    "log2": ("np.log2({})", lambda z, a: (1 / (math.log(2) * a),)),
    "sqrt": ("np.sqrt({})", lambda z, a: (0.5 / np.maximum(z, TINY),)),
    "sin": ("np.sin({})", lambda z, a: (np.cos(a),)),
    "cos": ("np.cos({})", lambda z, a: (-np.sin(a),)),
    "tan": ("np.tan({})", lambda z, a: (1 + z * z,)),
    "arcsin": ("np.arcsin({})", lambda z, a: (1 / np.maximum(np.sqrt(1 - a * a), TINY),)),
    "arccos": ("np.arccos({})", lambda z, a: (-1 / np.maximum(np.sqrt(1 - a * a), TINY),)),
    "arctan": ("np.arctan({})", lambda z, a: (1 / (1 + a * a),)),
    "sinh": ("np.sinh({})", lambda z, a: (_bounded(np.cosh(a)),)),
    "cosh": ("np.cosh({})", lambda z, a: (_bounded(np.sinh(a)),)),
    "tanh": ("np.tanh({})", lambda z, a: (1 - z * z,)),
    "arcsinh": ("np.arcsinh({})", lambda z, a: (1 / np.sqrt(1 + a * a),)),
    "arccosh": ("np.arccosh({})", lambda z, a: (1 / np.maximum(np.sqrt(a * a - 1), TINY),)),
    "arctanh": ("np.arctanh({})", lambda z, a: (1 / (1 - a * a),)),
    "hypot": (
        "np.hypot({}, {})",
        lambda z, a, b: (a / np.maximum(z, TINY), b / np.maximum(z, TINY)),
    ),
    "arctan2": (
        "np.arctan2({}, {})",
        lambda z, y, x: (x / np.maximum(x * x + y * y, TINY), -y / np.maximum(x * x + y * y, TINY)),
    ),
    "minimum": (
        "np.minimum({}, {})",
        lambda z, a, b: (0.5 - 0.5 * np.sign(a - b), 0.5 + 0.5 * np.sign(a - b)),
    ),
    "maximum": (
        "np.maximum({}, {})",
        lambda z, a, b: (0.5 + 0.5 * np.sign(a - b), 0.5 - 0.5 * np.sign(a - b)),
    ),
    "greater": ("{} > {}", _no_partials),
    "greater_equal": ("{} >= {}", _no_partials),
    "less": ("{} < {}", _no_partials),
    "less_equal": ("{} <= {}", _no_partials),
    "equal": ("{} == {}", _no_partials),
    "not_equal": ("{} != {}", _no_partials),
    "logical_and": ("{} & {}", _no_partials),
    "logical_or": ("{} | {}", _no_partials),
    "logical_not": ("np.logical_not({})", _no_partials),
    "where": ("np.where({}, {}, {})", _no_partials),  # `gradient` selects a branch
}
"""Python template of each operation, and its partial derivatives by its value and arguments."""
UFUNCS = {name: name for name in (*OPERATIONS, "square", "positive")} | {
    "bitwise_and": "logical_and",
    "bitwise_or": "logical_or",
    "invert": "logical_not",
    "true_divide": "divide",
    "float_power": "power",
    "fabs": "absolute",
}
"""Operations of NumPy's elementwise functions, by their names."""


def trace(function: Callable[..., Any], *arguments: Any, **keywords: Any) -> Symbol:
    """Return the graph of a function; raises NotAFormulaError if it has none or a too long one."""
    result: Symbol = of_symbols(lambda: _symbol(function(*arguments, **keywords)))
    if len(ordered([result])) > MOST:
        raise NotAFormulaError(f"the formula has more than {MOST} operations")
    return result


def of_symbols(call: Callable[[], Any]) -> Any:
    """Return the result of a call with symbols.

    Raises NotAFormulaError if the call needs the value of a symbol, even if it catches the error.
    """
    refusals: list[NotAFormulaError] = []
    token = REFUSALS.set(refusals)
    try:
        result = call()
    except Exception as error:
        raise NotAFormulaError(str(error)) from error
    finally:
        REFUSALS.reset(token)
    if refusals:
        raise refusals[0]
    return result


def gradient(result: Symbol, variables: Sequence[Symbol]) -> list[Symbol]:
    """Return the derivatives of a result by arguments; they hold everywhere except at jumps."""
    branches: dict[Symbol, list[Symbol]] = {}
    for symbol in ordered([result]):
        if symbol.operation == "where":
            for branch in symbol.arguments[1:]:
                branches[branch] = _slopes(branch, variables, branches)
    return _slopes(result, variables, branches)


def _slopes(
    result: Symbol, variables: Sequence[Symbol], branches: Mapping[Symbol, Sequence[Symbol]]
) -> list[Symbol]:
    """Return the gradient, given the gradients of all branches of `where`.

    The condition selects derivatives as it selects values, so infinite derivatives of the other
    branch have no effect.
    """
    adjoints: dict[Symbol, Any] = {result: constant(1.0)}
    slopes: list[Any] = [0.0] * len(variables)
    for symbol in reversed(ordered([result], ends=(ARGUMENT, CONSTANT, "where"))):
        adjoint = adjoints.get(symbol)
        if adjoint is None or symbol.operation in (ARGUMENT, CONSTANT):
            continue
        if symbol.operation == "where":
            condition, *both = symbol.arguments
            for k, pair in enumerate(zip(*(branches[branch] for branch in both), strict=True)):
                slopes[k] += _product(adjoint, operation("where", condition, *pair))
            continue
        partials = OPERATIONS[symbol.operation][1](symbol, *symbol.arguments)
        for child, partial in zip(symbol.arguments, partials, strict=True):
            if child.operation != CONSTANT:
                adjoints[child] = adjoints.get(child, 0) + _product(adjoint, partial)
    return [
        _symbol(slope + adjoints.get(variable, 0.0))
        for slope, variable in zip(slopes, variables, strict=True)
    ]


def _product(adjoint: Any, partial: Any) -> Any:
    """Return the product of derivatives, with 0 times anything equal to 0."""
    return 0.0 if 0 in (_symbol(adjoint).number, _symbol(partial).number) else adjoint * partial


def arguments_of(results: Iterable[Symbol]) -> set[str]:
    """Return the names of the arguments of results."""
    return {s.arguments[0] for s in ordered(results) if s.operation == ARGUMENT}


def ordered(results: Iterable[Symbol], ends: Sequence[str] = (ARGUMENT, CONSTANT)) -> list[Symbol]:
    """Return all symbols under results in topological order, without going below `ends`."""
    order: list[Symbol] = []
    seen: set[Symbol] = set()
    complete: set[Symbol] = set()
    stack = list(results)
    while stack:
        symbol = stack.pop()
        if symbol in complete:
            continue
        if symbol in seen or symbol.operation in ends:
            complete.add(symbol)
            order.append(symbol)
        else:  # it follows its arguments
            seen.add(symbol)
            stack.append(symbol)
            stack += symbol.arguments
    return order
