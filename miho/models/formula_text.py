"""Formulas as text: graphs written as plain Python functions, and expressions parsed to graphs."""

from __future__ import annotations

import ast
import difflib
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from miho.models.symbolic import (
    ARGUMENT,
    CONSTANT,
    OPERATIONS,
    Symbol,
    constant,
    operation,
    ordered,
)

OPERATORS: Mapping[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
FUNCTIONS = {name: name for name in ("exp", "log", "sqrt", "sin", "cos", "tan", "tanh")} | {
    "abs": "absolute",
    "atan": "arctan",
    "min": "minimum",
    "max": "maximum",
}
"""Functions that an expression may call, with their operations."""
CONSTANTS = {"pi": np.pi}
LONGEST = 1000
"""Largest number of characters of an expression."""
EXAMPLE = (
    "use numbers, parameter names, + - * / ** and "
    f"{', '.join(FUNCTIONS)}, for example '1 - a - b' or '2 * sqrt(C)'"
)


def written(
    name: str, signature: Mapping[str, Sequence[str]], results: Sequence[Symbol], single: bool
) -> Callable[..., Any]:
    """Return a plain function that computes the results and evaluates each operation once.

    `signature` maps the function's arguments, which are tuples, to the names of their symbols.
    Symbols are called p0 or x0, because a user's names could shadow functions. The function
    returns the `single` result, or a tuple of all results.
    """
    lines = [f"def {name}({', '.join(signature)}):"]
    lines += [f"    ({', '.join(names)},) = {tuple_}" for tuple_, names in signature.items()]
    statements, places = _assignments(results)
    lines += [f"    {line}" for line in statements]
    returned = ", ".join(places)
    lines.append(f"    return {returned if single else f'({returned},)'}")
    return _function(name, "\n".join(lines))


def _assignments(results: Sequence[Symbol]) -> tuple[list[str], list[str]]:
    """Return lines that compute the results, each operation once, and the term of each result."""
    lines: list[str] = []
    places: dict[Symbol, str] = {}
    values: dict[str, str] = {}  # variables by formula, so that no formula is evaluated twice
    for symbol in ordered(results):
        if symbol.operation == ARGUMENT:
            places[symbol] = symbol.arguments[0]
        elif symbol.operation == CONSTANT:
            places[symbol] = _literal(symbol.arguments[0])
        else:
            formula = _formula(symbol, places)
            if formula not in values:
                values[formula] = f"_{len(values)}"
                lines.append(f"{values[formula]} = {formula}")
            places[symbol] = values[formula]
    return lines, [places[result] for result in results]


@lru_cache(maxsize=256)
def _function(name: str, text: str) -> Callable[..., Any]:
    """Return the compiled function, cached for all fits of a model."""
    names: dict[str, Any] = {"np": np}
    exec(compile(text, f"<{name}>", "exec"), names)  # noqa: S102 -- generated lines
    function: Callable[..., Any] = names[name]
    return function


def _formula(symbol: Symbol, places: Mapping[Symbol, str]) -> str:
    """Return the formula of an operation; an integer exponent is written as an integer."""
    parts = [places[child] for child in symbol.arguments]
    if symbol.operation == "power":
        exponent = symbol.arguments[1].number
        if exponent is not None and exponent.is_integer():
            parts[1] = f"({int(exponent)})"
    return OPERATIONS[symbol.operation][0].format(*parts)


def _literal(number: float) -> str:
    """Return a number as a Python expression."""
    if math.isfinite(number):
        return f"({number!r})"
    return "np.nan" if math.isnan(number) else f"({math.copysign(1, number)!r} * np.inf)"


def formula_from(
    text: str,
    place: str,
    names: Mapping[str, object],
    symbol_of: Callable[[str], Symbol],
) -> Symbol:
    """Return the formula of an expression of `names`.

    The text is parsed with an allow-list of arithmetic and never executed.
    """
    if not isinstance(text, str):
        raise ValueError(f"{place}: {text!r} is not an expression; {EXAMPLE}")
    try:
        tree = ast.parse(text.strip() if len(text) <= LONGEST else "(", mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        raise ValueError(f"{place}: {text[:80]!r} is not an expression; {EXAMPLE}") from None

    def convert(node: ast.AST) -> Any:
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            return constant(float(node.value))  # type: ignore[arg-type]
        if isinstance(node, ast.Name):
            if node.id in names:
                return symbol_of(node.id)
            if node.id in CONSTANTS:
                return constant(CONSTANTS[node.id])
            near = difflib.get_close_matches(node.id, names, 1)
            hint = f"did you mean {near[0]}?" if near else f"choose from {', '.join(names)}"
            raise ValueError(f"{place}: {text!r} uses an unknown parameter {node.id}; {hint}")
        if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
            return OPERATORS[type(node.op)](convert(node.left), convert(node.right))
        if isinstance(node, ast.UnaryOp) and type(node.op) in OPERATORS:
            return OPERATORS[type(node.op)](convert(node.operand))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
            wanted = 2 if node.func.id in ("min", "max") else 1
            if node.func.id in FUNCTIONS and len(node.args) == wanted:
                return operation(FUNCTIONS[node.func.id], *map(convert, node.args))
        part = ast.get_source_segment(text.strip(), node) or text
        raise ValueError(f"{place}: {part[:80]!r} is not allowed; {EXAMPLE}")

    try:
        result: Symbol = convert(tree)
    except OverflowError:
        raise ValueError(f"{place}: {text[:80]!r} contains a number that is too large") from None
    except RecursionError:
        raise ValueError(f"{place}: {text[:80]!r} is nested too deeply; {EXAMPLE}") from None
    if result.number is not None and not np.isfinite(result.number):
        raise ValueError(
            f"{place}: expected a finite number, got {result.number:g} from {text[:80]!r}"
        )
    return result
