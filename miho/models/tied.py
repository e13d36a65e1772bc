"""A model of free parameters: the other parameters are fixed or tied to the free ones.

Methods, intervals and checks see a model with fewer parameters and need no special cases.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from miho.models.expression import Expression
from miho.models.formula_parser import formula_from
from miho.models.formula_text import written
from miho.models.model import Model, Wrapper
from miho.models.symbolic import (
    Symbol,
    argument,
    arguments_of,
    constant,
    gradient,
    operation,
    trace,
)
from miho.models.traced import Remade, TracedExpression, is_formula
from miho.quantities import Array
from miho.radial_map import RadialMap
from miho.validate import is_number


@dataclass(frozen=True)
class Ties(Remade):
    """Expressions of a model's parameters in terms of free parameters.

    Parameters
    ----------
    parameters : tuple of str
        Parameters of the model, in its order.
    free : Mapping[str, str]
        Units of the free parameters, in the order of theta. They are parameters of the model, or
        occur in expressions only.
    ties : Mapping[str, float or str]
        Number or expression of each other parameter and of each quantity. Expressions may use
        free, tied and fixed parameters.
    limits : Mapping[str, tuple[float, float]], optional
        Bounds of tied parameters and quantities. Outside them, the model has no value (NaN).
    quantities : Mapping[str, str], optional
        Units of tied quantities that are not parameters of the model.
    radial : RadialMap, optional
        Map from free parameters that are shares to points. Expressions refer to the points.

    Raises
    ------
    ValueError
        If an expression is not arithmetic, has an unknown name, or is part of a cycle.
    """

    parameters: tuple[str, ...]
    free: Mapping[str, str]
    ties: Mapping[str, float | str]
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    quantities: Mapping[str, str] = field(default_factory=dict)
    radial: RadialMap | None = None

    def __post_init__(self) -> None:
        _ = self.graphs

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the model's parameters, in its order, then of the quantities."""
        return (*self.parameters, *self.quantities)

    @cached_property
    def graphs(self) -> tuple[Symbol, ...]:
        """Formula of each of `names` in the free parameters."""
        formulas: dict[str, Symbol] = dict(zip(self.free, self.arguments, strict=True))
        return tuple(self._resolved(name, formulas, ()) for name in self.names)

    @cached_property
    def arguments(self) -> list[Symbol]:
        """The free parameters."""
        return [argument(f"p{k}") for k in range(len(self.free))]

    def _resolved(self, name: str, formulas: dict[str, Symbol], above: tuple[str, ...]) -> Symbol:
        """Return the formula of a parameter; `above` is the chain of expressions that use it."""
        if name in above:
            cycle = " -> ".join([*above[above.index(name) :], name])
            raise ValueError(f"space.{name}.tied: {cycle} is a cycle; tie to a free parameter")
        if name not in formulas:
            tie = self.ties[name]
            if isinstance(tie, str):
                place = f"space.{name}.tied"
                names = {k: v for k, v in formulas.items() if k in self.free} | dict.fromkeys(
                    self.ties
                )
                formulas[name] = formula_from(
                    tie, place, names, lambda other: self._resolved(other, formulas, (*above, name))
                )
            elif is_number(tie):
                formulas[name] = constant(float(tie))
            else:
                raise ValueError(
                    f"space.{name}.tied: is {tie!r}; expected an expression as text, such as "
                    "'2 * b'"
                )
        return formulas[name]

    @property
    def _signature(self) -> dict[str, list[str]]:
        return {"theta": [symbol.arguments[0] for symbol in self.arguments]}

    @cached_property
    def formula(self) -> Callable[[tuple[Any, ...]], tuple[Any, ...]]:
        """Function that maps a tuple of free parameters to the values of all `names`."""
        return written("parameters", self._signature, self.graphs, single=False)

    @cached_property
    def slopes(self) -> tuple[tuple[Symbol, ...], ...]:
        """Derivatives of all `names` with respect to the free parameters, (k, f)."""
        return tuple(tuple(gradient(graph, self.arguments)) for graph in self.graphs)

    @cached_property
    def wall(self) -> Symbol | None:
        """Formula that is 0 inside all limits and NaN outside; None without limits."""
        total: Any = None
        for name, bounds in self.limits.items():
            graph = self.graphs[self.names.index(name)]
            for sign, bound in zip((1, -1), bounds, strict=True):
                if np.isfinite(bound):
                    inside = operation("sqrt", sign * graph - sign * bound)
                    total = inside if total is None else total + inside
        return None if total is None else Symbol("multiply", constant(0.0), total)

    @cached_property
    def wall_formula(self) -> Callable[[tuple[Any, ...]], Any] | None:
        """The wall as a function of the tuple of free parameters."""
        wall = self.wall
        return None if wall is None else written("wall", self._signature, [wall], single=True)

    def walls(self, thetas: Array) -> Array | None:
        """Return the wall (n,) at free parameters (n, f), None without limits."""
        if self.wall_formula is None:
            return None
        with np.errstate(invalid="ignore"):
            return np.asarray(self.wall_formula(tuple(self._points(thetas).T)))

    @cached_property
    def shares(self) -> list[int]:
        """Positions of the radial map's shares among the free parameters."""
        return (
            [] if self.radial is None else [[*self.free].index(n) for n in self.radial.share_names]
        )

    def _points(self, thetas: Array) -> Array:
        """Return the arguments (n, f) of the formulas at free parameters (n, f)."""
        if self.radial is None:
            return thetas
        points = thetas.copy()
        points[:, self.shares] = self.radial.points(thetas[:, self.shares])
        return points

    def values(self, thetas: Array) -> Array:
        """Return the values (n, k) of all `names` at free parameters (n, f)."""
        with np.errstate(all="ignore"):
            columns = self.formula(tuple(self._points(thetas).T))
        return np.stack([np.broadcast_to(column, len(thetas)) for column in columns], axis=1)

    def whole(self, thetas: Array) -> Array:
        """Return the model's parameters (n, d) at free parameters (n, f)."""
        return self.values(thetas)[:, : len(self.parameters)]

    @cached_property
    def _slope_formula(self) -> Callable[[tuple[Any, ...]], tuple[Any, ...]]:
        flat = [slope for row in self.slopes for slope in row]
        return written("slopes", self._signature, flat, single=False)

    def value_slopes(self, thetas: Array) -> Array:
        """Return the derivatives (n, k, f) of all `names` at free parameters (n, f)."""
        with np.errstate(all="ignore"):
            values = self._slope_formula(tuple(self._points(thetas).T))
        columns = [np.broadcast_to(value, len(thetas)) for value in values]
        slopes = np.stack(columns, 1).reshape(len(thetas), len(self.names), len(self.free))
        if self.radial is not None:
            slopes[:, :, self.shares] @= self.radial.slopes(thetas[:, self.shares])
        return slopes

    def linear(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return the free parameters in which a model is jointly linear.

        `names` are the model's linear parameters. A free parameter qualifies if neither a limit
        nor a nonlinear parameter of the model depends on it.
        """
        if self.radial is not None:
            return ()
        dependence: dict[str, set[str]] = {}  # of each slope of a linear one, by free parameter
        barred: set[str] = set()
        places = [symbol.arguments[0] for symbol in self.arguments]
        for name, graph, row in zip(self.names, self.graphs, self.slopes, strict=True):
            if name in self.limits or (name in self.parameters and name not in names):
                barred |= arguments_of([graph])
            if name not in names:
                continue
            for place, slope in zip(places, row, strict=True):
                dependence.setdefault(place, set()).update(arguments_of([slope]))
        used = arguments_of(self.graphs[: len(self.parameters)])
        linear: list[str] = []
        for place in places:
            others = {place, *linear}
            bent = not dependence.get(place, set()).isdisjoint(others)
            bent |= any(place in dependence[other] for other in linear)
            if place in used and place not in barred and not bent:
                linear.append(place)
        free = list(self.free)
        return tuple(free[places.index(place)] for place in linear)


def tie(model: Model, ties: Ties) -> Model:
    """Return the model of the free parameters, as an expression if possible."""
    if isinstance(model, Expression) and ties.radial is None:
        expression = TiedExpression(model, ties)
        if is_formula(expression):
            return expression
    return TiedModel(model, ties)


class Tied(Remade, Wrapper):
    """Base class of models of the free parameters only."""

    ties: Ties

    @property
    def whole(self) -> Model:
        """The model of all parameters."""
        return self.model

    def with_numbers(self) -> Model:
        """Return the tied model with functions called with numbers."""
        called = self.model.with_numbers()
        return self if called is self.model else TiedModel(called, self.ties)

    @property
    def parameters(self) -> Mapping[str, str]:
        """Units of the free parameters."""
        return self.ties.free

    @cached_property
    def linear(self) -> tuple[str, ...]:
        """Free parameters in which the output is jointly linear."""
        return self.ties.linear(self.model.linear)

    @property
    def name(self) -> str:
        """Name or class of the model."""
        return self.model.name or type(self.model).__name__.lower()

    def remarks(self, theta: Array, noise: float | Array, *inputs: Array) -> list[str]:
        """Return the remarks of the model of all parameters."""
        return self.model.remarks(self.ties.whole(theta[None])[0], noise, *inputs)


@dataclass(frozen=True)
class TiedModel(Tied):
    """Any model of the free parameters only."""

    model: Model
    ties: Ties

    def with_leaves(self, wrap: Callable[[Model], Model]) -> Model:
        """Return the tied model with wrapped leaves."""
        return replace(self, model=self.model.with_leaves(wrap))

    @property
    def ordered(self) -> bool:
        """Whether the model of all parameters is ordered."""
        return self.model.ordered

    @property
    def jacobian_cost(self) -> int:
        """Cost of the derivatives with respect to all parameters."""
        cost = self.model.jacobian_cost
        return len(self.model.parameters) if cost is None else cost

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Return the outputs (n, N) at free parameters (n, f), NaN outside the limits."""
        values = self.model.predict(self.ties.whole(thetas), *inputs)
        walls = self.ties.walls(thetas)
        if walls is not None:
            values += walls[:, None]
        return values

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Return the derivatives of the outputs, (N, f), at free parameters (f,)."""
        derivatives = self.model.jacobian(self.ties.whole(theta[None])[0], *inputs)
        slopes = self.ties.value_slopes(theta[None])[0, : len(self.ties.parameters)]
        return np.asarray(derivatives @ slopes)


@dataclass(frozen=True)
class TiedExpression(Tied, TracedExpression):
    """An expression of the free parameters only."""

    model: Expression
    ties: Ties

    @cached_property
    def graph(self) -> Symbol:
        """Graph of the output; raises NotAFormulaError if the expression cannot be traced."""
        parameters = self.ties.graphs[: len(self.ties.parameters)]
        output = trace(self.model.value, self.columns, parameters)
        return output if self.ties.wall is None else Symbol("add", output, self.ties.wall)
