"""Several models of rows of their own with parameters in common: several outputs or datasets."""

from __future__ import annotations

import contextlib
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.models.expression import Expression
from miho.models.layout import OUTPUT
from miho.models.model import Model
from miho.models.symbolic import NotAFormulaError, Symbol, operation, trace
from miho.models.tied import whole_model
from miho.models.traced import TracedExpression
from miho.quantities import Array

PART = "part of the row"
"""The first input: the position of the part that a row belongs to."""


class JointPart(NamedTuple):
    """A model with the names that its parameters, in its order, have among all."""

    name: str
    model: Model
    parameters: tuple[str, ...]


@dataclass(frozen=True)
class JointModel(Model):
    """The output of the part that a row belongs to; columns that other parts read may be anything.

    A parameter of one name is one parameter. Inputs of one name stand in one column; they and such
    parameters must agree in their units. Raises ValueError if not. `output` is the parts' unit, ""
    where they differ.
    """

    parts: tuple[JointPart, ...]

    def __post_init__(self) -> None:
        for group in ("inputs", "parameters"):
            units: dict[str, tuple[str, str]] = {}
            for part in self.parts:
                own: Mapping[str, str] = part.model.inputs
                if group == "parameters":
                    values = part.model.parameters.values()
                    own = dict(zip(part.parameters, values, strict=True))
                for name, unit in own.items():
                    first, needed = units.setdefault(name, (part.name, unit))
                    if unit != needed:
                        raise ValueError(
                            f"{name} has the unit {needed!r} in {first} and {unit!r} in "
                            f"{part.name}; use one, or another name"
                        )

    def with_leaves(self, wrap: Callable[[Model], Model]) -> Model:
        """The joint model of parts with wrapped leaves."""
        return JointModel(
            tuple(part._replace(model=part.model.with_leaves(wrap)) for part in self.parts)
        )

    @cached_property
    def inputs(self) -> Mapping[str, str]:  # type: ignore[override]
        """The part, then the inputs of all."""
        units = {PART: "-"}
        for part in self.parts:
            units |= part.model.inputs
        return units

    @cached_property
    def parameters(self) -> Mapping[str, str]:  # type: ignore[override]
        """Those of all parts, in the order in which they come first."""
        units: dict[str, str] = {}
        for part in self.parts:
            own = zip(part.parameters, part.model.parameters.values(), strict=True)
            units |= {name: unit for name, unit in own if name not in units}
        return units

    @property
    def output(self) -> str:  # type: ignore[override]
        """The parts' unit, "" where they differ."""
        units = {part.model.output for part in self.parts}
        return units.pop() if len(units) == 1 else ""

    @property
    def name(self) -> str:  # type: ignore[override]
        """The names of the parts."""
        return "-".join(part.name for part in self.parts)

    @property
    def defaults(self) -> Mapping[str, float]:  # type: ignore[override]
        """Of the parameters that have the same default in each part that they belong to."""
        values: dict[str, set[float | None]] = {}
        for part in self.parts:
            own = part.model.defaults
            for name, joint in zip(part.model.parameters, part.parameters, strict=True):
                values.setdefault(joint, set()).add(own.get(name))
        known = {name: each.pop() for name, each in values.items() if len(each) == 1}
        return {name: value for name, value in known.items() if value is not None}

    @property
    def ordered(self) -> bool:  # type: ignore[override]
        """Whether any part needs every row in order."""
        return any(part.model.ordered for part in self.parts)

    @cached_property
    def linear(self) -> tuple[str, ...]:  # type: ignore[override]
        """The parameters in which every part that has them is linear.

        A row depends on one part, so those are jointly linear that are so in each.
        """

        def bent(name: str) -> bool:
            return any(
                name in part.parameters
                and list(part.model.parameters)[part.parameters.index(name)]
                not in part.model.linear
                for part in self.parts
            )

        return tuple(name for name in self.parameters if not bent(name))

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Outputs (n, N) of parameter rows (n, d) at input columns (N,), the first the part."""
        values = np.empty((len(thetas), inputs[0].size))
        for part, rows, chosen, columns in self._shares(inputs):
            values[:, rows] = part.model.predict(thetas[:, chosen], *columns)
        return values

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the outputs, (N, d), at one configuration (d,)."""
        derivatives = np.zeros((inputs[0].size, theta.size))
        for part, rows, chosen, columns in self._shares(inputs):
            slopes = part.model.jacobian(theta[chosen], *columns)
            derivatives[rows[:, None], chosen] = slopes
        return derivatives

    def _shares(
        self, inputs: tuple[Array, ...]
    ) -> list[tuple[JointPart, NDArray[np.intp], list[int], list[Array]]]:
        """Each part with its rows, the positions of its parameters, and its columns."""
        names, places = list(self.inputs), list(self.parameters)
        shares = []
        for k, part in enumerate(self.parts):
            rows = np.flatnonzero(inputs[0] == k)
            if rows.size:
                columns = [inputs[names.index(name)][rows] for name in part.model.inputs]
                shares.append((part, rows, [places.index(n) for n in part.parameters], columns))
        return shares


@dataclass(frozen=True)
class JointExpression(TracedExpression):
    """A joint model whose parts are one expression: that of the parameters that the part selects.

    So the machine can run it; and NumPy evaluates it sooner than part by part.
    """

    joint: JointModel
    expression: Expression
    inputs: Mapping[str, str] = field(init=False)
    parameters: Mapping[str, str] = field(init=False)
    output: str = field(init=False)
    linear: tuple[str, ...] = field(init=False)
    name: str = field(init=False)

    def __post_init__(self) -> None:
        for key in ("inputs", "parameters", "output", "linear", "name"):
            object.__setattr__(self, key, getattr(self.joint, key))

    @cached_property
    def graph(self) -> Symbol:
        """The output; raises NotAFormulaError for an expression that cannot be traced."""
        index, *columns = self.columns
        symbols = dict(zip(self.parameters, self.arguments, strict=True))
        count = range(len(self.joint.parts))
        chosen = [operation("maximum", 0.0, 1 - abs(index - k)) for k in count]  # 1 in part k, or 0

        def selected(names: tuple[str, ...]) -> Symbol:
            if len(set(names)) == 1:
                return symbols[names[0]]
            terms = [own * symbols[name] for own, name in zip(chosen, names, strict=True)]
            total: Symbol = reduce(operator.add, terms)
            return total

        names = zip(*(part.parameters for part in self.joint.parts), strict=True)
        return trace(self.expression.value, tuple(columns), tuple(map(selected, names)))


def joined(model: JointModel) -> Model:
    """A joint model as an expression, if its parts are one that can be traced."""
    first = model.parts[0].model
    with contextlib.suppress(NotAFormulaError, ValueError):  # arrays in models do not compare
        if isinstance(first, Expression) and all(part.model == first for part in model.parts):
            expression = JointExpression(model, first)
            _ = expression.graph
            return expression
    return model


def parts_of(model: Model) -> tuple[JointPart, ...]:
    """The parts of a joint model, also of one that is an expression or tied; none of another."""
    whole = whole_model(model)
    whole = whole.joint if isinstance(whole, JointExpression) else whole
    return whole.parts if isinstance(whole, JointModel) else ()


def rows_of_parts(model: Model, inputs: Sequence[Array]) -> dict[str, NDArray[np.bool_]]:
    """Which rows (N,) belong to each part of a joint model, by name.

    Those of each output of a model that has several; none of another model.
    """
    columns = dict(zip(model.inputs, inputs, strict=True))
    names = [part.name for part in parts_of(model)]
    if not names and OUTPUT in columns:
        outputs = getattr(whole_model(model), "outputs", ())
        names = [getattr(output, "__name__", output) for output in outputs]
    index = columns.get(PART, columns.get(OUTPUT))
    return {} if index is None else {name: index == k for k, name in enumerate(names)}
