"""Source code of plain Python functions that evaluate graphs with NumPy."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from miho.models.symbolic import ARGUMENT, CONSTANT, OPERATIONS, Symbol, ordered


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
