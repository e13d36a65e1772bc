"""Priors: what is known of parameters besides the data, as further residuals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from miho.identification.inverse_root import inverse_root
from miho.models.symbolic import Symbol
from miho.models.tied import Ties
from miho.optim.space import Parameter, Space
from miho.quantities import Array

if TYPE_CHECKING:
    import pandas as pd

    from miho.identification.curve_fit import CurveFit
    from miho.identification.uncertainty import Linearised


FAR = 3.0
"""An estimate so many deviations from its prior's mean is mentioned."""


@dataclass(frozen=True)
class PriorResiduals:
    """The residuals of the parameters that have a prior: `scale` (u - mean) / std.

    u is the parameter, or its logarithm on a logarithmic scale; `scale` is the unit of the data's
    residuals, so that the sum of squares is twice the negative logarithm of the posterior (Gelman
    et al., Bayesian Data Analysis, 3rd ed. 2013, Ch. 14.8). The bounds of the space truncate. The
    parameters are free ones of the `space`, and those of `tied` that follow from them by `ties`.
    """

    space: Space
    scale: float
    tied: tuple[Parameter, ...] = ()
    ties: Ties | None = None

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those that have a prior, (P,), the free ones first."""
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
        """Those of them that are tied, as formulas of the free parameters."""
        return [] if self.ties is None else [self.ties.graphs[k] for k in self._tied]

    def values(self, thetas: Array) -> Array:
        """The parameters (n, P) at configurations (n, d)."""
        if self.ties is None:
            return thetas[:, self._free]
        return np.hstack([thetas[:, self._free], self.ties.values(thetas)[:, self._tied]])

    def gradients(self, theta: Array) -> Array:
        """Their derivatives (P, d) at one configuration (d,)."""
        free = np.eye(theta.size)[self._free]
        if self.ties is None:
            return free
        return np.vstack([free, self.ties.value_slopes(theta[None])[0, self._tied]])

    def deviations(self, thetas: Array) -> Array:
        """How many standard deviations they are from the mean, (n, P)."""
        mean, std = np.array([p.prior for p in self.parameters], dtype=float).T
        values = self.values(thetas)
        with np.errstate(invalid="ignore", divide="ignore"):
            logs = np.log(values / np.where(self._log, mean, 1.0))
        return np.asarray(np.where(self._log, logs, values - mean) / std)

    def residuals(self, thetas: Array) -> Array:
        """(n, P) of configurations (n, d)."""
        return self.scale * self.deviations(thetas)

    def slopes(self, theta: Array) -> Array:
        """Their derivatives (P, d) at one configuration (d,)."""
        std = np.array([p.prior[1] for p in self.parameters if p.prior is not None])
        unit = np.where(self._log, self.values(theta[None])[0], 1.0) * std
        return np.asarray(self.scale * self.gradients(theta) / unit[:, None])


def prior_table(problem: CurveFit, at: Linearised) -> pd.DataFrame:
    """What each prior added: its mean and standard deviation, how many of these the estimate is
    from there, the standard error from the data alone, and the share of what is known of the
    parameter that the priors give."""
    import pandas as pd

    if problem.prior is None:
        return pd.DataFrame()
    parameters, gradients = problem.prior.parameters, problem.prior.gradients(at.theta)
    root = inverse_root(problem.error_slopes(at.theta), np.flatnonzero(~at.at_bound))
    alone = replace(
        at, covariance=at.noise**2 * root.half @ root.half.T, null_directions=root.null
    ).spread(gradients)
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
    """In sentences, what of the parameters is the priors' and what the data's."""
    sentences = []
    for row in table.to_dict("records"):
        if np.isfinite(row["of the priors [%]"]):  # which of a parameter at its bound it is not
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
