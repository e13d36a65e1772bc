"""Expressions given by a graph; their formulas are generated when needed."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

from miho.compiled.kernel import Formula
from miho.models.expression import Expression
from miho.models.formula_text import written
from miho.models.symbolic import (
    BENDS,
    NotAFormulaError,
    Symbol,
    argument,
    arguments_of,
    gradient,
    ordered,
)

Known = tuple[Formula, tuple[int, ...]]
KNOWN: WeakKeyDictionary[Formula, Known] = WeakKeyDictionary()
"""Derivatives of formulas and positions of linear parameters, cached per process."""


class Remade:
    """A frozen dataclass whose cached properties are not pickled."""

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields only; a field that an older pickle lacks has its default."""
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]


def is_formula(model: Expression) -> bool:
    """Return whether the value of a model has a formula."""
    try:
        _ = model.graph if isinstance(model, TracedExpression) else model.value
    except NotAFormulaError:
        return False
    return True


@dataclass(frozen=True)
class TracedExpression(Remade, Expression):
    """An expression given by `graph`, a formula of the symbols in `columns` and `arguments`."""

    @property
    @abstractmethod
    def graph(self) -> Symbol:
        """Graph of the output."""

    @cached_property
    def columns(self) -> tuple[Symbol, ...]:
        """Symbols of the inputs: x0, x1, ..."""
        return tuple(argument(f"x{k}") for k in range(len(self.inputs)))

    @cached_property
    def arguments(self) -> tuple[Symbol, ...]:
        """Symbols of the parameters: p0, p1, ..."""
        return tuple(argument(f"p{k}") for k in range(len(self.parameters)))

    @cached_property
    def value(self) -> Formula:
        """Function that computes the output."""
        return self._written("value", [self.graph], single=True)

    @cached_property
    def derivatives(self) -> Formula:
        """Function that computes the derivatives by the parameters."""
        return self._known[0]

    @property
    def jointly_linear(self) -> tuple[str, ...]:
        """Parameters in which the output is jointly linear, chosen in their order."""
        names = tuple(self.parameters)
        return tuple(names[k] for k in self._known[1])

    @cached_property
    def _known(self) -> Known:
        known = KNOWN.get(self.value)
        if known is None:
            slopes = gradient(self.graph, self.arguments)
            known = (
                self._written("derivatives", slopes, single=False),
                tuple(jointly_linear(self.graph, self.arguments, slopes)),
            )
            KNOWN[self.value] = known
        return known

    def _written(self, name: str, results: list[Symbol], single: bool) -> Callable[..., Any]:
        groups = {"inputs": self.columns, "theta": self.arguments}
        signature = {key: [s.arguments[0] for s in symbols] for key, symbols in groups.items()}
        return written(name, signature, results, single)


def jointly_linear(
    result: Symbol, variables: Sequence[Symbol], slopes: Sequence[Symbol]
) -> list[int]:
    """Return the positions of variables in which a result is jointly linear.

    Variables are added in their order while the result stays jointly linear. `slopes` are the
    derivatives by the variables.
    """
    positions: list[int] = []
    dependence = [arguments_of([slope]) for slope in slopes]
    names = [variable.arguments[0] for variable in variables]
    used = arguments_of([result]) - arguments_of(
        s for s in ordered([result]) if s.operation in BENDS
    )  # without variables in conditions and kinks, which have constant derivatives on both sides
    for k, name in enumerate(names):
        others = [names[i] for i in positions]
        bent = any(name in dependence[i] for i in positions)
        if name in used and not bent and dependence[k].isdisjoint([name, *others]):
            positions.append(k)
    return positions
