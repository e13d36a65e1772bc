"""A model times a weight for each row, whose squares are a weighted sum of squares."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from miho.models.expression import Expression
from miho.models.model import Model
from miho.models.symbolic import NotAFormulaError, Symbol, operation, trace
from miho.models.traced import TracedExpression
from miho.quantities import Array

WEIGHT = "weight of the row"
"""The last input, behind the model's own."""


def weighted(model: Model) -> Model:
    """The model whose output is that of another one times the last input, the weight."""
    if isinstance(model, Expression):
        expression = WeightedExpression(model)
        with contextlib.suppress(NotAFormulaError):
            _ = expression.graph
            return expression
    return WeightedModel(model)


class _Weighted(Model):
    """What both kinds take from the model."""

    model: Model

    @cached_property
    def inputs(self) -> Mapping[str, str]:  # type: ignore[override]
        return {**self.model.inputs, WEIGHT: "-"}

    @property
    def parameters(self) -> Mapping[str, str]:  # type: ignore[override]
        return self.model.parameters

    @property
    def output(self) -> str:  # type: ignore[override]
        return self.model.output

    @property
    def linear(self) -> tuple[str, ...]:  # type: ignore[override]
        return self.model.linear

    @property
    def name(self) -> str:  # type: ignore[override]
        return self.model.name


@dataclass(frozen=True)
class WeightedModel(_Weighted):
    """Any model, weighted."""

    model: Model

    def with_leaves(self, wrap: Callable[[Model], Model]) -> Model:
        """The weighted model with wrapped leaves."""
        return WeightedModel(self.model.with_leaves(wrap))

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Weighted outputs (n, N)."""
        return np.asarray(self.model.predict(thetas, *inputs[:-1]) * inputs[-1])

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Their derivatives, (N, d)."""
        return np.asarray(self.model.jacobian(theta, *inputs[:-1]) * inputs[-1][:, None])


@dataclass(frozen=True)
class WeightedExpression(_Weighted, TracedExpression):
    """An expression, weighted."""

    model: Expression

    @cached_property
    def graph(self) -> Symbol:
        """The weighted output; raises NotAFormulaError for one that cannot be traced."""
        output = trace(self.model.value, self.columns[:-1], self.arguments)
        return operation("multiply", output, self.columns[-1])
