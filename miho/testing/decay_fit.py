"""The problem for checks of methods."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from miho.optim import LeastSquaresProblem, Parameter, Space
from miho.optim.problem import mean_square
from miho.quantities import Array
from miho.testing.patience import restart_patience


class DecayFit(LeastSquaresProblem):
    """Fit y = a exp(-b t), with a on a linear and b on a log scale, and record all evaluations.

    Parameters
    ----------
    spoil : callable, optional
        Maps parameters (n, d) and losses (n,) of a batch to modified losses.

    Attributes
    ----------
    thetas, losses : list
        All loss evaluations in order. The loss is +inf at a fidelity below one, which cannot become
        best. All data are used at any fidelity.
    spent : float
        Cost of losses, residuals and Jacobians; a fidelity counts as that fraction.
    """

    name = "conformance"
    space = Space(
        (
            Parameter("a", "V", -5.0, 5.0, sigma_max=0.5),
            Parameter("b", "1/s", 0.01, 10.0, scale="log", sigma_max=0.3),
        )
    )
    linear = ("a",)

    def __init__(self, spoil: Callable[[Array, Array], Array] | None = None) -> None:
        self.t = np.linspace(0.0, 2.0, 17)
        self.y = 2.0 * np.exp(-1.5 * self.t) + 0.05 * np.cos(40 * self.t)
        self.thetas: list[Array] = []
        self.losses: list[float] = []
        self.spent = 0.0
        self._spoil = spoil

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Mean squared residual (n,), modified by `spoil`."""
        losses = mean_square(thetas[:, :1] * np.exp(-thetas[:, 1:] * self.t) - self.y)
        if self._spoil is not None:
            losses = self._spoil(thetas, losses)
        self._remember(thetas, losses if fidelity == 1.0 else np.full(len(thetas), np.inf))
        self.spent += len(thetas) * fidelity
        return losses

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Model minus data, (17,)."""
        residuals = theta[0] * np.exp(-theta[1] * self.t) - self.y
        if self._spoil is not None and not np.isfinite(
            self._spoil(theta[None], mean_square(residuals)[None])
        ):
            residuals = np.full_like(residuals, np.nan)
        self._remember(theta[None], mean_square(residuals)[None])
        self.spent += 1
        return np.asarray(residuals)

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Derivatives of the residuals, (17, 2)."""
        decay = np.exp(-theta[1] * self.t)
        self.spent += 2
        restart_patience()
        return np.stack([decay, -theta[0] * self.t * decay], axis=1)

    def _remember(self, thetas: Array, losses: Array) -> None:
        self.thetas.extend(thetas.copy())
        self.losses.extend(losses.tolist())
        restart_patience()
