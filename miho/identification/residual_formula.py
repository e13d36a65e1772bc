"""Residuals of a curve fit as formulas, with which the machine runs robust losses and priors."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from miho.identification.loss import Cauchy, Huber, Loss, Square
from miho.identification.prior import PriorResiduals
from miho.models.expression import Expression
from miho.models.model import Model
from miho.models.symbolic import NotAFormulaError, Symbol, operation, trace
from miho.models.traced import TracedExpression
from miho.models.weighted import WithInput
from miho.quantities import Array


class ResidualFormula(NamedTuple):
    """A formula whose output at columns (N,) minus `target` (N,) is the residuals."""

    model: Expression
    columns: tuple[Array, ...]
    target: Array


def residual_formula(
    model: Model,
    columns: tuple[Array, ...],
    target: Array,
    rho: Loss,
    prior: PriorResiduals | None,
) -> ResidualFormula | None:
    """Residuals of a model of `target` (N,), with their loss or priors; None without a formula."""
    if not isinstance(model, Expression):
        return None
    formula = ResidualFormula(model, columns, target)
    if isinstance(rho, Huber | Cauchy):
        formula = ResidualFormula(
            RobustExpression(model, rho), (*columns, target), np.zeros(target.size)
        )
    elif not isinstance(rho, Square):
        return None
    if prior is not None:
        rows, P = target.size, len(prior.parameters)
        padded = [np.append(column, np.repeat(column[:1], P)) for column in formula.columns]
        row = np.append(np.zeros(rows), np.arange(1.0, P + 1))
        formula = ResidualFormula(
            PriorExpression(formula.model, prior),
            (*padded, row),
            np.append(formula.target, np.zeros(P)),
        )
    with contextlib.suppress(NotAFormulaError):
        _ = formula.model.value
        return formula
    return None


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
