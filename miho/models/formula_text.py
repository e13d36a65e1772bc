"""Graphs written out as plain Python functions, which NumPy evaluates and numba compiles."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from miho.compiled.elementary import atan, cos, sin, where
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
    statements, places = assignments(results)
    lines += [f"    {line}" for line, _ in statements]
    returned = ", ".join(places)
    lines.append(f"    return {returned if single else f'({returned},)'}")
    return defined(name, lines)


def assignments(
    results: Sequence[Symbol], names: Mapping[str, str] | None = None
) -> tuple[list[tuple[str, frozenset[str]]], list[str]]:
    """Lines that compute results, each operation once, and what to write for each result.

    With each line come the arguments that it depends on; `names` is what to write for these, if
    not their own names.
    """
    lines: list[tuple[str, frozenset[str]]] = []
    places: dict[Symbol, str] = {}
    needs: dict[Symbol, frozenset[str]] = {}
    values: dict[str, str] = {}  # by what they are computed from, so that none is computed twice
    for symbol in ordered(results):
        if symbol.operation == ARGUMENT:
            name = symbol.arguments[0]
            needs[symbol] = frozenset([name])
            places[symbol] = name if names is None else names[name]
        elif symbol.operation == CONSTANT:
            needs[symbol] = frozenset()
            places[symbol] = _literal(symbol.arguments[0])
        else:
            formula = _formula(symbol, places)
            needs[symbol] = frozenset().union(*(needs[child] for child in symbol.arguments))
            if formula not in values:
                values[formula] = f"_{len(values)}"
                lines.append((f"{values[formula]} = {formula}", needs[symbol]))
            places[symbol] = values[formula]
    return lines, [places[result] for result in results]


def defined(name: str, lines: Iterable[str]) -> Callable[..., Any]:
    """The function of that name that lines define, with NumPy and our elementary functions."""
    return _function(name, "\n".join(lines))


@lru_cache(maxsize=256)
def _function(name: str, text: str) -> Callable[..., Any]:
    """The function of this text, made once for all fits of a model."""
    names: dict[str, Any] = {"np": np, "sin": sin, "cos": cos, "atan": atan, "where": where}
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
