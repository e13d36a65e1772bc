"""Priors: what is known of parameters besides the data, as further residuals."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from miho.identification.inverse_root import inverse_root
from miho.optim.space import Space
from miho.quantities import Array

if TYPE_CHECKING:
    import pandas as pd

    from miho.identification.curve_fit import CurveFit
    from miho.identification.uncertainty import Linearised


@dataclass(frozen=True)
class PriorResiduals:
    """The residuals of the parameters that have a prior: `scale` (u - mean) / std.

    u is the parameter, or its logarithm on a logarithmic scale; `scale` is the unit of the data's
    residuals, so that the sum of squares is twice the negative logarithm of the posterior (Gelman
    et al., Bayesian Data Analysis, 3rd ed. 2013, Ch. 14.8). The bounds of the space truncate.
    """

    space: Space
    scale: float

    @cached_property
    def indices(self) -> NDArray[np.intp]:
        """Positions of the parameters that have one, (P,)."""
        return np.flatnonzero([p.prior is not None for p in self.space.parameters])

    @cached_property
    def _moments(self) -> tuple[Array, Array]:
        """Means in search coordinates and standard deviations, (P,) each."""
        pairs = [p.prior for p in self.space.parameters if p.prior is not None]
        means = np.array([mean for mean, _ in pairs])
        log = np.array([self.space.parameters[k].scale == "log" for k in self.indices])
        return np.where(log, np.log(np.where(log, means, 1.0)), means), np.array(
            [std for _, std in pairs]
        )

    def residuals(self, thetas: Array) -> Array:
        """(n, P) of configurations (n, d)."""
        mean, std = self._moments
        return self.scale * (self.space.encode(thetas)[:, self.indices] - mean) / std

    def slopes(self, theta: Array) -> Array:
        """Their derivatives (P, d) at one configuration (d,)."""
        slopes = np.zeros((self.indices.size, theta.size))
        log = [self.space.parameters[k].scale == "log" for k in self.indices]
        inner = np.where(log, 1 / theta[self.indices], 1.0)
        slopes[np.arange(self.indices.size), self.indices] = self.scale * inner / self._moments[1]
        return slopes


def prior_table(problem: CurveFit, at: Linearised) -> pd.DataFrame:
    """What each prior added: its mean and standard deviation, the standard error from the data
    alone, and the share of what is known of the parameter that the priors give."""
    import pandas as pd

    if problem.prior is None:
        return pd.DataFrame()
    root = inverse_root(problem.error_slopes(at.theta), np.flatnonzero(~at.at_bound))
    errors = at.noise * np.linalg.norm(root.half, axis=1)
    errors[root.moved.any(axis=0)] = np.inf
    errors[at.at_bound] = np.nan
    table = []
    for k in problem.prior.indices:
        parameter = problem.space.parameters[k]
        mean, std = parameter.prior or (np.nan, np.nan)
        table.append(
            {
                "parameter": parameter.name,
                "prior mean": mean,
                "prior deviation": std,
                "error from the data alone": errors[k],
                "standard error": at.standard_errors[k],
                "of the priors [%]": 100 * (1 - (at.standard_errors[k] / errors[k]) ** 2),
            }
        )
    return pd.DataFrame(table)


def prior_notes(table: pd.DataFrame) -> list[str]:
    """In sentences, what of the parameters is the priors' and what the data's."""
    return [
        f"of what is known of {row['parameter']} the priors give {row['of the priors [%]']:.0f} %: "
        f"its standard error is {row['standard error']:.3g}, and from the data alone "
        f"{row['error from the data alone']:.3g}."
        for row in table.to_dict("records")
    ]
