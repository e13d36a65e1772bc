"""Losses, and the residuals of a curve fit, evaluated by the machine of `miho.core` or by NumPy."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.compiled import kernel_for, taped_loss
from miho.models.expression import Expression
from miho.models.model import Model
from miho.models.traced import TracedExpression, is_formula
from miho.optim.problem import mean_square
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.compiled.fit import FitKernel
    from miho.compiled.taped import TapedLoss
    from miho.identification.prior import PriorResiduals
    from miho.identification.robust_loss import LatestErrors

BLOCK = 50_000
"""Model values per block; the temporaries of one block stay in the cache of one core."""


class Loss(ABC):
    """A loss function rho, as the square of transformed residuals sign(r) sqrt(rho(r)).

    Every method for least squares can minimise the mean square of transformed residuals.
    """

    @abstractmethod
    def transform(self, residuals: Array) -> Array:
        """Residuals of any shape as sign(r) sqrt(rho(r)), in the same unit; may reuse the array."""

    @abstractmethod
    def influence(self, residuals: Array) -> tuple[Array, Array]:
        """The influence psi = rho'(r) / 2 and its derivative (Huber, Robust Statistics, 1981)."""


@dataclass(frozen=True)
class Square(Loss):
    """The squared error rho = r^2, the loss of the paper (Eq. 5), for noise without outliers."""

    def transform(self, residuals: Array) -> Array:
        """The residuals themselves."""
        return residuals

    def influence(self, residuals: Array) -> tuple[Array, Array]:
        """The influence psi = r and its derivative 1."""
        return residuals, np.ones_like(residuals)


class ResidualFormula(NamedTuple):
    """A formula whose output at columns (N,) minus `target` (N,) is the residuals."""

    model: Expression
    columns: tuple[Array, ...]
    target: Array


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals and their derivatives at parameters, over some rows or all.

    Errors are the output of `model` at `columns` minus `target`, (N,) each. A loss `rho` transforms
    them to residuals, and a `prior` adds residuals after the rows. Methods take the number of
    `rows`, which are the first of an order, or None for all. `order` returns this order, and
    `trials` the configurations at which the machine is compared with NumPy. `compiled` says whether
    the machine may be used.
    """

    model: Model
    columns: tuple[Array, ...]
    target: Array
    rho: Loss
    prior: PriorResiduals | None
    order: Callable[[], NDArray[np.intp]]
    trials: Callable[[], Array]
    name: str
    compiled: bool

    @property
    def _plain(self) -> bool:
        """Whether the residuals are the errors."""
        return isinstance(self.rho, Square) and self.prior is None

    @cached_property
    def _taped_errors(self) -> TapedLoss | None:
        """The errors on the machine, None if it cannot run them."""
        if not isinstance(self.model, Expression):
            return None
        columns = np.array(self.columns)
        return taped_loss(self.model, columns, self.target, self.order)

    @cached_property
    def _traced(self) -> TapedLoss | None:
        """The errors of a traced function on the machine; it needs no check against NumPy."""
        return self._taped_errors if isinstance(self.model, TracedExpression) else None

    @cached_property
    def _formula(self) -> ResidualFormula | None:
        """All residuals as a formula, None without one."""
        if not isinstance(self.model, Expression):
            return None
        formula: ResidualFormula | None
        formula = ResidualFormula(self.model, self.columns, self.target)
        if not self._plain:
            from miho.identification.residual_expressions import transformed

            formula = transformed(*formula, self.rho, self.prior)
        return formula if formula and is_formula(formula.model) else None

    @cached_property
    def taped(self) -> TapedLoss | None:
        """All residuals on the machine, None if it cannot or may not run them."""
        if self._formula is None or not self.compiled:
            return None
        if self._plain:
            return self._taped_errors
        model, columns, target = self._formula
        order = self.order if self.prior is None else lambda: np.arange(target.size)
        return taped_loss(model, np.array(columns), target, order)

    @cached_property
    def kernel(self) -> FitKernel | None:
        """Fast forms of the loss, None if the machine cannot run it."""
        if self.taped is None or self._formula is None:
            return None
        return kernel_for(self.taped, self._formula.model, self.trials(), name=self.name)

    def losses(self, thetas: Array, rows: int | None) -> Array:
        """Mean squares (n,) of the residuals at configurations (n, d)."""
        if self._traced is not None and self._plain:
            return self._traced.losses(thetas, rows)
        if self.kernel is not None:
            by_machine = self.kernel.losses(thetas, rows)
            if by_machine is not None:
                return by_machine
        columns, target = self._first(rows)
        block, losses = max(1, BLOCK // target.size), np.empty(len(thetas))
        for start in range(0, len(thetas), block):
            batch = thetas[start : start + block]
            residuals = self.model.predict(batch, *columns)
            residuals -= target
            residuals = self._with_prior(batch, self.rho.transform(residuals))
            losses[start : start + block] = mean_square(residuals)
        return losses

    def errors(self, thetas: Array, rows: int | None) -> Array:
        """Errors (n, m) at configurations (n, d)."""
        if self._traced is not None:
            return self._traced.residuals(thetas, rows)
        if rows is None and self._plain and self.kernel is not None:
            by_machine = self.kernel.residuals(thetas)
            if by_machine is not None:
                return by_machine
        columns, target = self._first(rows)
        errors = self.model.predict(thetas, *columns)
        errors -= target
        return np.asarray(errors)

    def values(self, thetas: Array, rows: int | None) -> Array:
        """Residuals (n, m) at configurations (n, d)."""
        errors = self.errors(thetas, rows)
        if isinstance(self.rho, Square):
            return self._with_prior(thetas, errors)
        self._latest.keep(thetas, errors)
        return self.rho.transform(errors)

    def jacobian(self, theta: Array, rows: int | None) -> Array:
        """Derivatives of the residuals, (m, d), at one configuration (d,)."""
        derivatives = None
        if self._traced is not None:
            derivatives = self._traced.jacobian(theta, rows)
        elif rows is None and self._plain and self.kernel is not None:
            derivatives = self.kernel.jacobian(theta)
        if derivatives is None:
            derivatives = self.model.jacobian(theta, *self._first(rows)[0])
        if self.prior is not None:
            return np.vstack([derivatives, self.prior.slopes(theta)])
        if isinstance(self.rho, Square):
            return derivatives
        from miho.identification.robust_loss import slope

        errors = self._latest.at(theta, len(derivatives))
        if errors is None:
            errors = self.errors(theta[None], rows)[0]
        return np.asarray(slope(self.rho, errors)[:, None] * derivatives)

    @cached_property
    def _latest(self) -> LatestErrors:
        from miho.identification.robust_loss import LatestErrors

        return LatestErrors()

    def _with_prior(self, thetas: Array, residuals: Array) -> Array:
        """Residuals (n, N), followed by the residuals of priors."""
        if self.prior is None:
            return residuals
        return np.hstack([residuals, self.prior.residuals(thetas)])

    def _first(self, rows: int | None) -> tuple[tuple[Array, ...], Array]:
        """Columns and target of the first rows of the order, or of all rows."""
        if rows is None:
            return self.columns, self.target
        part = self.order()[:rows]
        return tuple(column[part] for column in self.columns), self.target[part]
