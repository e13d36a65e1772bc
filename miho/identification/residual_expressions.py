"""Formulas of weighted outputs, of transformed residuals, and of the residuals of priors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from miho.identification.prior import PriorResiduals
from miho.identification.residuals import Loss, ResidualFormula, Square
from miho.identification.robust_loss import Cauchy, Huber
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


def transformed(
    model: Expression,
    columns: tuple[Array, ...],
    target: Array,
    rho: Loss,
    prior: PriorResiduals | None,
) -> ResidualFormula | None:
    """The formula of errors (N,) with a loss or priors; None for a loss that is no formula."""
    if isinstance(rho, Huber | Cauchy):
        model, columns = RobustExpression(model, rho), (*columns, target)
        target = np.zeros(target.size)
    elif not isinstance(rho, Square):
        return None
    if prior is not None:
        N, P = target.size, len(prior.parameters)
        padded = [np.append(column, np.repeat(column[:1], P)) for column in columns]
        model = PriorExpression(model, prior)
        columns = (*padded, np.append(np.zeros(N), np.arange(1.0, P + 1)))
        target = np.append(target, np.zeros(P))
    return ResidualFormula(model, columns, target)


@dataclass(frozen=True)
class RobustExpression(WithInput, TracedExpression):
    """Transformed residuals of an expression, whose last input is the measured output."""

    model: Expression
    rho: Huber | Cauchy
    added: ClassVar[str] = "measured output"

    @cached_property
    def graph(self) -> Symbol:
        """Graph of the transformed residual; raises NotAFormulaError if it cannot be traced."""
        output = trace(self.model.value, self.columns[:-1], self.arguments)
        return trace(self.rho.transform, operation("subtract", output, self.columns[-1]))


@dataclass(frozen=True)
class PriorExpression(WithInput, TracedExpression):
    """An expression with rows for priors: the last input is 0 for data, and k for the k-th prior.

    A row of a prior has the prior's residual.
    """

    model: Expression
    prior: PriorResiduals
    added: ClassVar[str] = "number of the prior"

    @cached_property
    def graph(self) -> Symbol:
        """Graph of the output; raises NotAFormulaError if it cannot be traced."""
        row, output = self.columns[-1], trace(self.model.value, self.columns[:-1], self.arguments)
        total: Any = np.where(row == 0, output, 0.0)
        for k, residual in enumerate(self.prior.formulas(self.arguments), start=1):
            total = total + np.where(row == k, residual, 0.0)
        graph: Symbol = total
        return graph
