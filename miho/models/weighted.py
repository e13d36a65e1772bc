"""A model with weighted outputs, for a weighted sum of squares."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from miho.models.expression import Expression
from miho.models.model import Model, Wrapper
from miho.models.symbolic import Symbol, operation, trace
from miho.models.traced import TracedExpression, is_formula
from miho.quantities import Array

WEIGHT = "weight of the row"
"""Name of the last input."""


def weighted(model: Model) -> Model:
    """Return the model with its output multiplied by a last input, the weight."""
    if isinstance(model, Expression) and is_formula(expression := WeightedExpression(model)):
        return expression
    return WeightedModel(model)


class WithInput(Wrapper):
    """Base class of a model with one more input, `added`, than its `model`."""

    added: ClassVar[str] = WEIGHT

    @cached_property
    def inputs(self) -> Mapping[str, str]:
        """The model's inputs and the added one, which has no unit."""
        return {**self.model.inputs, self.added: "-"}


@dataclass(frozen=True)
class WeightedModel(WithInput):
    """Any model with weighted outputs."""

    model: Model

    def with_leaves(self, wrap: Callable[[Model], Model]) -> Model:
        """Return the weighted model with wrapped leaves."""
        return WeightedModel(self.model.with_leaves(wrap))

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Return the weighted outputs (n, N)."""
        return np.asarray(self.model.predict(thetas, *inputs[:-1]) * inputs[-1])

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Return the derivatives of the weighted outputs, (N, d)."""
        return np.asarray(self.model.jacobian(theta, *inputs[:-1]) * inputs[-1][:, None])


@dataclass(frozen=True)
class WeightedExpression(WithInput, TracedExpression):
    """An expression with weighted outputs."""

    model: Expression

    @cached_property
    def graph(self) -> Symbol:
        """Graph of the weighted output; raises NotAFormulaError if it cannot be traced."""
        output = trace(self.model.value, self.columns[:-1], self.arguments)
        return operation("multiply", output, self.columns[-1])
