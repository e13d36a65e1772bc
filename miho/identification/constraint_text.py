"""Linear constraints and forms as text: read from the user, and written as expressions."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from miho.models.formula_parser import formula_from
from miho.models.formula_text import written
from miho.models.symbolic import Symbol, argument, constant, gradient
from miho.optim.space import Parameter, Space
from miho.quantities import Array

RELATION = re.compile(r"(<=|>=|==|<|>|=)")
EXAMPLE = "expected linear relations, for example 'a < b < c', 'a + b = 1' or 'b - a < 5'"


class Form(NamedTuple):
    """The linear form coefficients (d,) @ theta + offset."""

    coefficients: Array
    offset: float

    def minus(self, other: Form) -> Form:
        """The difference."""
        return Form(self.coefficients - other.coefficients, self.offset - other.offset)

    def solved_for(self, k: int) -> Form:
        """The form that parameter k equals if this form is 0."""
        others = self.coefficients.copy()
        others[k] = 0.0
        return Form(-others / self.coefficients[k], -self.offset / self.coefficients[k])


class Constraint(NamedTuple):
    """A form that is at least 0, or exactly 0 if `equal`; `text` is the user's constraint."""

    form: Form
    equal: bool
    text: str


Ends = tuple[list[Form], list[Form]]
"""Lower and upper bounds of a parameter, as forms."""


def stated_in(space: Space, text: str) -> list[Constraint]:
    """The constraints in one chain."""
    parts = RELATION.split(text) if isinstance(text, str) else []
    if len(parts) < 3 or not all(part.strip() for part in parts):
        raise ValueError(f"constraints: {EXAMPLE}; got {text!r}")
    forms = [_form(space, part.strip()) for part in parts[::2]]
    relations = []
    for left, relation, right in zip(forms, parts[1::2], forms[1:], strict=False):
        form = left.minus(right) if relation in (">", ">=") else right.minus(left)
        if not form.coefficients.any():
            raise ValueError(
                f"constraints: {text!r} has a part without free parameters; remove that part"
            )
        relations.append(Constraint(form, relation in ("=", "=="), text))
    return relations


def _form(space: Space, text: str) -> Form:
    """An expression as a linear form of the free parameters."""
    places = [f"p{k}" for k in range(len(space))]
    symbols: dict[str, Symbol] = {}
    for place, parameter in zip(places, space.parameters, strict=True):
        fixed = parameter.fixed
        symbols[parameter.name] = argument(place) if fixed is None else constant(fixed)
    graph = formula_from(text, "constraints", symbols, symbols.__getitem__)
    slopes = [slope.number for slope in gradient(graph, [argument(place) for place in places])]
    if None in slopes or not np.isfinite(np.array(slopes, dtype=float)).all():
        raise ValueError(f"constraints: {text!r} is not linear; tie a parameter to others instead")
    coefficients = np.array(slopes, dtype=float)
    for k in np.flatnonzero(coefficients):
        if space.parameters[k].tied is not None:
            raise ValueError(
                f"constraints: {text!r} has {space.names[k]}, which is tied to "
                f"{space.parameters[k].tied!r}; write that expression instead"
            )
    value = written("value", {"theta": places}, [graph], single=True)
    return Form(coefficients, float(value((0.0,) * len(space))))


def share_of_range(parameter: Parameter, ends: Ends, names: Sequence[str], share: str) -> str:
    """The expression of a parameter as a share of its range."""
    lower, upper = ends
    first, last = _extreme("max", lower, names), _extreme("min", upper, names)
    if parameter.scale == "log":
        return f"{_grouped(first)} * ({_grouped(last)} / {_grouped(first)}) ** {share}"
    width = f"{last} - {_grouped(first)}" if first != "0" else last
    if len(lower) == len(upper) == 1:
        width = form_text(upper[0].minus(lower[0]), names)
    expression = f"{_grouped(width)} * {share}"
    return f"{first} + {expression}" if first != "0" else expression


def _extreme(function: str, forms: Sequence[Form], names: Sequence[str]) -> str:
    """The maximum or minimum of forms, as an expression."""
    text = form_text(forms[0], names)
    for form in forms[1:]:
        text = f"{function}({text}, {form_text(form, names)})"
    return text


def _grouped(text: str) -> str:
    """An expression in parentheses, unless it is one name or number."""
    return text if re.fullmatch(r"[\w.]+", text) else f"({text})"


def form_text(form: Form, names: Sequence[str]) -> str:
    """A form as an expression, with positive terms first."""
    terms = [(float(a), name) for a, name in zip(form.coefficients, names, strict=True) if a]
    if form.offset or not terms:
        terms.append((float(form.offset), ""))
    text = ""
    for number, name in sorted(terms, key=lambda term: (term[0] < 0, not term[1])):
        size = f"{abs(number):.15g}"
        body = size if not name else name if size == "1" else f"{size} * {name}"
        text += f" {'-' if number < 0 else '+'} {body}" if text else "-" * (number < 0) + body
    return text
