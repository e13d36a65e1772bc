"""Graphs written out as plain Python functions, which NumPy evaluates."""

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
    """A plain function that computes results, each operation once.

    `signature` maps its arguments, which are tuples, to the names of the symbols that they hold:
    p0 and x0 rather than a user's names, which could be those of functions. It gives the `single`
    result, or a tuple of all.
    """
    lines = [f"def {name}({', '.join(signature)}):"]
    lines += [f"    ({', '.join(names)},) = {tuple_}" for tuple_, names in signature.items()]
    statements, places = _assignments(results)
    lines += [f"    {line}" for line in statements]
    returned = ", ".join(places)
    lines.append(f"    return {returned if single else f'({returned},)'}")
    return _function(name, "\n".join(lines))


def _assignments(results: Sequence[Symbol]) -> tuple[list[str], list[str]]:
    """Lines that compute results, each operation once, and what to write for each result."""
    lines: list[str] = []
    places: dict[Symbol, str] = {}
    values: dict[str, str] = {}  # by what they are computed from, so that none is computed twice
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
    """The function of this text, made once for all fits of a model."""
    names: dict[str, Any] = {"np": np}
    exec(compile(text, f"<{name}>", "exec"), names)  # noqa: S102 -- lines of our own
    function: Callable[..., Any] = names[name]
    return function


def _formula(symbol: Symbol, places: Mapping[Symbol, str]) -> str:
    """An operation as it is written; a power by a whole number, which is multiplied out, as one."""
    parts = [places[child] for child in symbol.arguments]
    if symbol.operation == "power":
        exponent = symbol.arguments[1].number
        if exponent is not None and exponent.is_integer():
            parts[1] = f"({int(exponent)})"
    return OPERATIONS[symbol.operation][0].format(*parts)


def _literal(number: float) -> str:
    """A number as it is written in a formula."""
    if math.isfinite(number):
        return f"({number!r})"
    return "np.nan" if math.isnan(number) else f"({math.copysign(1, number)!r} * np.inf)"
