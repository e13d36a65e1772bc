"""Priors: knowledge of parameters that does not come from the data, as further residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from miho.models.symbolic import Symbol
from miho.models.tied import Ties
from miho.optim.space import Parameter, Space
from miho.quantities import Array

if TYPE_CHECKING:
    import pandas as pd

    from miho.identification.curve_fit import CurveFit
    from miho.identification.uncertainty import Linearised


FAR = 3.0
"""An estimate is mentioned if it is more standard deviations away from its prior mean."""


@dataclass(frozen=True)
class PriorResiduals:
    """The residuals of the parameters that have a prior: `scale` (u - mean) / std.

    u is the parameter, or its logarithm on a logarithmic scale. The sum of squares of all residuals
    over `scale`^2 is twice the negative logarithm of the posterior, up to a constant (Gelman et
    al., Bayesian Data Analysis, 3rd ed. 2013, Ch. 14.8). The bounds of the space truncate priors.

    Parameters
    ----------
    space : Space
        The free parameters, some of which have a prior.
    scale : float
        Standard deviation of the weighted errors of the data, in the unit of their residuals.
    tied : tuple of Parameter
        Tied parameters that have a prior.
    ties : Ties, optional
        The expressions that give the tied parameters.
    """

    space: Space
    scale: float
    tied: tuple[Parameter, ...] = ()
    ties: Ties | None = None

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The P parameters that have a prior, the free ones first."""
        return (*(p for p in self.space.parameters if p.prior is not None), *self.tied)

    @cached_property
    def _log(self) -> NDArray[np.bool_]:
        return np.array([p.scale == "log" for p in self.parameters])

    @cached_property
    def _free(self) -> list[int]:
        return [k for k, p in enumerate(self.space.parameters) if p.prior is not None]

    @cached_property
    def _tied(self) -> list[int]:
        return [] if self.ties is None else [self.ties.names.index(p.name) for p in self.tied]

    @property
    def tied_graphs(self) -> list[Symbol]:
        """The tied parameters that have a prior, as formulas of the free parameters."""
        return [] if self.ties is None else [self.ties.graphs[k] for k in self._tied]

    def values(self, thetas: Array) -> Array:
        """Values (n, P) of the parameters at configurations (n, d)."""
        if self.ties is None:
            return thetas[:, self._free]
        return np.hstack([thetas[:, self._free], self.ties.values(thetas)[:, self._tied]])

    def gradients(self, theta: Array) -> Array:
        """Derivatives (P, d) of `values` at one configuration (d,)."""
        free = np.eye(theta.size)[self._free]
        if self.ties is None:
            return free
        return np.vstack([free, self.ties.value_slopes(theta[None])[0, self._tied]])

    def deviations(self, thetas: Array) -> Array:
        """Distances (n, P) from the prior means, in standard deviations."""
        mean, std = np.array([p.prior for p in self.parameters], dtype=float).T
        values = self.values(thetas)
        with np.errstate(invalid="ignore", divide="ignore"):
            logs = np.log(values / np.where(self._log, mean, 1.0))
        return np.asarray(np.where(self._log, logs, values - mean) / std)

    def residuals(self, thetas: Array) -> Array:
        """Residuals (n, P) at configurations (n, d)."""
        return self.scale * self.deviations(thetas)

    def formulas(self, arguments: Sequence[Symbol]) -> list[Symbol]:
        """Formulas of the residuals of one configuration, in the symbols of its d parameters."""
        formulas: list[Any] = []
        for parameter, u in zip(
            self.parameters, [*(arguments[k] for k in self._free), *self.tied_graphs], strict=True
        ):
            mean, std = parameter.prior or (0.0, 1.0)
            deviation = np.log(u / mean) if parameter.scale == "log" else u - mean
            formulas.append(self.scale * (deviation / std))
        return formulas

    def slopes(self, theta: Array) -> Array:
        """Derivatives (P, d) of `residuals` at one configuration (d,)."""
        std = np.array([p.prior[1] for p in self.parameters if p.prior is not None])
        unit = np.where(self._log, self.values(theta[None])[0], 1.0) * std
        return np.asarray(self.scale * self.gradients(theta) / unit[:, None])


def prior_table(problem: CurveFit, at: Linearised) -> pd.DataFrame:
    """A row per prior with its contribution to the estimate; empty without priors.

    Columns: mean and standard deviation of the prior, distance of the estimate from the mean in
    standard deviations, standard error from the data alone and from data and priors, and the share
    of the information on the parameter that the priors supply, in %.
    """
    import pandas as pd

    from miho.identification.uncertainty import with_rows

    if problem.prior is None:
        return pd.DataFrame()
    parameters, gradients = problem.prior.parameters, problem.prior.gradients(at.theta)
    alone = with_rows(at, problem.error_slopes(at.theta), 0).spread(gradients)
    errors = np.where(np.isnan(alone), np.nan, at.spread(gradients))
    mean, std = np.array([p.prior for p in parameters], dtype=float).T
    return pd.DataFrame(
        {
            "parameter": [p.name for p in parameters],
            "prior mean": mean,
            "prior deviation": std,
            "deviations from it": problem.prior.deviations(at.theta[None])[0],
            "error from the data alone": alone,
            "standard error": errors,
            "of the priors [%]": 100 * (1 - (errors / alone) ** 2),
        }
    )


def prior_notes(table: pd.DataFrame) -> list[str]:
    """Sentences on the information that priors supply, and on priors that contradict the data."""
    sentences = []
    for row in table.to_dict("records"):
        if np.isfinite(row["of the priors [%]"]):  # NaN for a parameter at a bound
            sentences.append(
                f"the priors supply {row['of the priors [%]']:.0f} % of the information on "
                f"{row['parameter']}: its standard error is {row['standard error']:.3g}, and "
                f"{row['error from the data alone']:.3g} from the data alone."
            )
        if abs(row["deviations from it"]) > FAR:
            sentences.append(
                f"{row['parameter']} is {abs(row['deviations from it']):.3g} standard deviations "
                f"away from its prior mean, {row['prior mean']:g}: data and prior contradict each "
                "other."
            )
    return sentences
