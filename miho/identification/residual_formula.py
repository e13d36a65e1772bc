"""Residuals of a curve fit as formulas, with which the machine runs robust losses and priors."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from miho.identification.loss import Loss, Square
from miho.identification.robust_loss import Cauchy, Huber
from miho.models.expression import Expression
from miho.models.model import Model
from miho.models.traced import is_formula
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.identification.prior import PriorResiduals


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
        from miho.identification.residual_expressions import RobustExpression

        formula = ResidualFormula(
            RobustExpression(model, rho), (*columns, target), np.zeros(target.size)
        )
    elif not isinstance(rho, Square):
        return None
    if prior is not None:
        from miho.identification.residual_expressions import PriorExpression

        rows, P = target.size, len(prior.parameters)
        padded = [np.append(column, np.repeat(column[:1], P)) for column in formula.columns]
        row = np.append(np.zeros(rows), np.arange(1.0, P + 1))
        formula = ResidualFormula(
            PriorExpression(formula.model, prior),
            (*padded, row),
            np.append(formula.target, np.zeros(P)),
        )
    return formula if is_formula(formula.model) else None
