"""Joint models: several outputs or datasets with shared parameters."""

from __future__ import annotations

import contextlib
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.models.expression import Expression
from miho.models.layout import OUTPUT, PART
from miho.models.model import Model, Wrapper
from miho.models.symbolic import NotAFormulaError, Symbol, operation, trace
from miho.models.traced import TracedExpression
from miho.quantities import Array
from miho.units import differ


class JointPart(NamedTuple):
    """A model with the joint names of its parameters, in its order."""

    name: str
    model: Model
    parameters: tuple[str, ...]


@dataclass(frozen=True)
class JointModel(Model):
    """Several models, each of which predicts its rows of the data.

    Parts share parameters and input columns with the same name. Raises ValueError if the units of
    a shared name differ. A part ignores columns that are not its inputs. `output` is the unit of
    the parts, "" if their units differ.
    """

    parts: tuple[JointPart, ...]

    def __post_init__(self) -> None:
        _ = self.inputs, self.parameters  # raise if units differ

    def with_leaves(self, wrap: Callable[[Model], Model]) -> Model:
        """Return the joint model of parts with wrapped leaves."""
        return JointModel(
            tuple(part._replace(model=part.model.with_leaves(wrap)) for part in self.parts)
        )

    def with_numbers(self) -> Model:
        """Return the joint model of parts with functions called with numbers."""
        parts = tuple(part._replace(model=part.model.with_numbers()) for part in self.parts)
        pairs = zip(parts, self.parts, strict=True)
        return self if all(new.model is old.model for new, old in pairs) else JointModel(parts)

    @cached_property
    def inputs(self) -> Mapping[str, str]:
        """Units of the part's number and of the inputs of all parts."""
        return {PART: "-"} | self._units([part.model.inputs for part in self.parts])

    @cached_property
    def parameters(self) -> Mapping[str, str]:
        """Units of the parameters of all parts, in order of first use."""
        groups = [(part.parameters, part.model.parameters.values()) for part in self.parts]
        return self._units([dict(zip(*group, strict=True)) for group in groups])

    def _units(self, groups: Sequence[Mapping[str, str]]) -> dict[str, str]:
        """Return the units of all names, from a mapping of each part."""
        units: dict[str, str] = {}
        first: dict[str, str] = {}  # the first part with this name
        for part, group in zip(self.parts, groups, strict=True):
            for name, unit in group.items():
                known = units[name] = units.get(name) or unit  # "" is unknown
                if unit:
                    first.setdefault(name, part.name)
                if differ(unit, known):
                    raise ValueError(
                        f"{name} has the unit {known!r} in {first[name]} and {unit!r} in "
                        f"{part.name}; use one unit, or different names"
                    )
        return units

    @property
    def output(self) -> str:
        """Unit of the parts, "" if their units differ."""
        first, *others = (part.model.output for part in self.parts)
        return "" if "" in others or any(differ(first, unit) for unit in others) else first

    @property
    def name(self) -> str:
        """The names of the parts."""
        return "-".join(part.name for part in self.parts)

    @property
    def defaults(self) -> Mapping[str, float]:
        """Defaults of parameters with the same default in each part that uses them."""
        values: dict[str, set[float | None]] = {}
        for part in self.parts:
            own = part.model.defaults
            for name, joint in zip(part.model.parameters, part.parameters, strict=True):
                values.setdefault(joint, set()).add(own.get(name))
        known = {name: each.pop() for name, each in values.items() if len(each) == 1}
        return {name: value for name, value in known.items() if value is not None}

    @property
    def ordered(self) -> bool:
        """Whether any part needs every row in order."""
        return any(part.model.ordered for part in self.parts)

    @cached_property
    def linear(self) -> tuple[str, ...]:
        """Parameters in which every part that uses them is linear.

        Each row depends on one part, so the output is jointly linear in these parameters.
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
        """Return the outputs (n, N) of parameter rows (n, d); the first input is the part."""
        values = np.empty((len(thetas), inputs[0].size))
        for part, rows, chosen, columns in self.shares(inputs):
            values[:, rows] = part.model.predict(thetas[:, chosen], *columns)
        return values

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Return the derivatives of the outputs, (N, d), at one configuration (d,)."""
        derivatives = np.zeros((inputs[0].size, theta.size))
        for part, rows, chosen, columns in self.shares(inputs):
            slopes = part.model.jacobian(theta[chosen], *columns)
            derivatives[rows[:, None], chosen] = slopes
        return derivatives

    def remarks(self, theta: Array, noise: float | Array, *inputs: Array) -> list[str]:
        """Return the remarks of each part, after its name."""
        noises = np.broadcast_to(noise, inputs[0].shape)
        return [
            f"{part.name}: {remark}"
            for part, rows, chosen, columns in self.shares(inputs)
            for remark in part.model.remarks(theta[chosen], noises[rows], *columns)
        ]

    def shares(
        self, inputs: tuple[Array, ...]
    ) -> list[tuple[JointPart, NDArray[np.intp], list[int], list[Array]]]:
        """Return each part with its rows, the positions of its parameters, and its columns."""
        names, places = list(self.inputs), list(self.parameters)
        shares = []
        for k, part in enumerate(self.parts):
            rows = np.flatnonzero(inputs[0] == k)
            if rows.size:
                columns = [inputs[names.index(name)][rows] for name in part.model.inputs]
                shares.append((part, rows, [places.index(n) for n in part.parameters], columns))
        return shares


@dataclass(frozen=True)
class JointExpression(Wrapper, TracedExpression):
    """A joint model with one expression for all parts; the part's number selects parameters.

    The machine can run it, and NumPy evaluates it faster than part by part.
    """

    model: JointModel
    expression: Expression

    def with_numbers(self) -> Model:
        """Return the joint model of parts with functions called with numbers."""
        called = self.model.with_numbers()
        return self if called is self.model else called

    @cached_property
    def graph(self) -> Symbol:
        """Graph of the output; raises NotAFormulaError if the expression cannot be traced."""
        index, *columns = self.columns
        symbols = dict(zip(self.parameters, self.arguments, strict=True))
        count = range(len(self.model.parts))
        chosen = [operation("maximum", 0.0, 1 - abs(index - k)) for k in count]  # 1 in part k, or 0

        def selected(names: tuple[str, ...]) -> Symbol:
            if len(set(names)) == 1:
                return symbols[names[0]]
            terms = [own * symbols[name] for own, name in zip(chosen, names, strict=True)]
            total: Symbol = reduce(operator.add, terms)
            return total

        names = zip(*(part.parameters for part in self.model.parts), strict=True)
        return trace(self.expression.value, tuple(columns), tuple(map(selected, names)))


def joined(model: JointModel) -> Model:
    """Return a joint model as an expression if all parts are one that can be traced."""
    first = model.parts[0].model
    with contextlib.suppress(NotAFormulaError, ValueError):  # models with arrays do not compare
        if isinstance(first, Expression) and all(part.model == first for part in model.parts):
            expression = JointExpression(model, first)
            _ = expression.graph
            return expression
    return model


def parts_of(model: Model) -> tuple[JointPart, ...]:
    """Return the parts of a joint model, which may be an expression or tied; () for others."""
    whole = model.whole
    whole = whole.model if isinstance(whole, JointExpression) else whole
    return whole.parts if isinstance(whole, JointModel) else ()


def rows_of_parts(model: Model, inputs: Sequence[Array]) -> dict[str, NDArray[np.bool_]]:
    """Return the rows (N,) of each part of a joint model as masks by name.

    For a model with several outputs, return the rows of each output; otherwise an empty mapping.
    """
    columns = dict(zip(model.inputs, inputs, strict=True))
    names = [part.name for part in parts_of(model)]
    if not names and OUTPUT in columns:
        outputs = getattr(model.whole, "outputs", ())
        names = [getattr(output, "__name__", output) for output in outputs]
    index = columns.get(PART, columns.get(OUTPUT))
    return {} if index is None else {name: index == k for k, name in enumerate(names)}
