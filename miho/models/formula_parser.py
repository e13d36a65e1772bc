"""Formulas from text: expressions of parameters, parsed to graphs and never executed."""

from __future__ import annotations

import ast
import difflib
import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from miho.models.symbolic import Symbol, constant, operation

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


def formula_from(
    text: str, place: str, names: Mapping[str, object], symbol_of: Callable[[str], Symbol]
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
