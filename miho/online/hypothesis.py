"""One hypothesis of a population: its Gauss-Newton steps by the outputs of a row, in NumPy."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from miho.online.rules import Rules
from miho.quantities import Array

SMALLEST = 1e-300
LARGEST_NOISE = 1e6
"""Largest factor by which a suspected outlier is less certain, as one over its share of inliers."""
BEYOND = 1e150
"""Errors and deviations whose squares leave the range of doubles."""
TOGETHER = 0.5
"""Probability that an output is an outlier if another one of the row is."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Estimates `theta` (D,) of d parameters, then of states, and their covariance `P` in units.

    `weight` (1,) is the logarithm of the weight. These arrays change in place. `unit` (D,) are the
    units of parameters and states.
    """

    theta: Array
    P: Array
    weight: Array
    unit: Array
    d: int
    rules: Rules

    def set_state(self, c: int, value: float, variance: float) -> None:
        """Set the state c to a measured value."""
        k = self.d + c
        self.theta[k] = value
        self.P[k] = self.P[:, k] = 0.0
        self.P[k, k] = variance

    def correct(
        self, values: Array, J: Array, noisy: Array, free: NDArray[np.bool_], y: Array
    ) -> tuple[Array, float, Array]:
        """Correct the estimates by all outputs, states last.

        Returns the shares of the variances (d,) that the row takes away, its information, and the
        probability (m,) that each output is an inlier. `noisy` is the variance (m, q) of each
        output by the noise of each input.
        """
        d, theta, P = self.d, self.theta, self.P
        n, own = theta.size - d, self.rules.sigma**2
        others, before = noisy[:, n:].sum(axis=1), theta.copy()
        information, taught, inliers = 0.0, np.zeros(d), np.ones(y.size)
        able = np.append(free, np.full(n, True))
        for o in (*range(n, y.size), *range(n)):
            if o == 0 < n:
                self._predict(values, J, before, others)
            if math.isnan(y[o]):
                continue
            worth = float(J[o, :d] @ P[:d, :d] @ J[o, :d]) / (own[o] + noisy[o].sum())
            if o < n:
                j, r, e = self.unit * (np.arange(d + n) == d + o), own[o], y[o] - theta[d + o]
            else:
                j, r = J[o], own[o] + others[o]
                e = y[o] - values[o] - j @ ((theta - before) / self.unit)
            together = max(float(inliers.min()), 1 / LARGEST_NOISE)
            inlier, reduction = self._step(e, j, r, able, together)
            inliers[o], taught = inlier, taught + reduction
            information += inlier * worth
            if o < n:  # with an outlier, value or prediction is wrong: half way between
                most = 2 * math.sqrt(self.rules.width * r)
                half = min(max(0.5 * e, -most), most)
                theta[d + o] += (1 - inlier) * half
                P[d + o, d + o] += (1 - inlier) * half**2 / self.unit[d + o] ** 2
        return np.clip(taught, 0.0, 1.0), information, inliers

    def _step(
        self, e: float, j: Array, r: float, able: NDArray[np.bool_], together: float
    ) -> tuple[float, Array]:
        """Take one Gauss-Newton step; returns the inlier's probability and the reductions (d,)."""
        rules, d, P = self.rules, self.d, self.P
        Pj = P @ j
        S = float(j @ Pj) + r
        wide = S + rules.width * r
        # An impossible error says nothing; nor does a step without a number.
        if not (abs(e) < LARGEST_NOISE * math.sqrt(wide) and LARGEST_NOISE * wide < BEYOND**2):
            self.weight[0] += math.log(SMALLEST)
            return 0.0, np.zeros(d)
        share = rules.outliers * together + TOGETHER * (1 - together)
        likely = (1 - share) * math.exp(-0.5 * e * e / S) / math.sqrt(S)
        outlier = share * math.exp(-0.5 * e * e / wide) / math.sqrt(wide)
        self.weight[0] += math.log(likely + outlier + SMALLEST)
        inlier = max(likely / (likely + outlier + SMALLEST), 1 / LARGEST_NOISE)
        S /= inlier
        gain = np.where(able, Pj / S, 0.0)
        self.theta[:] += self.unit * gain * e
        self.theta[:d] = np.clip(self.theta[:d], rules.low, rules.high)
        reduction = (gain * (2 * Pj - S * gain))[:d] / np.maximum(P.diagonal()[:d], SMALLEST)
        P += S * np.outer(gain, gain) - np.outer(gain, Pj) - np.outer(Pj, gain)
        return inlier, reduction

    def _predict(self, values: Array, J: Array, before: Array, others: Array) -> None:
        """Move the states to the end of the row; `others` is the variance (m,) by other inputs."""
        d, theta, P = self.d, self.theta, self.P
        n = theta.size - d
        theta[d:] = values[:n] + J[:n] @ ((theta - before) / self.unit)
        onward = J[:n] / self.unit[d:, None]
        carried = onward @ P
        own = carried @ onward.T
        P[d:, :d], P[:d, d:], P[d:, d:] = carried[:, :d], carried[:, :d].T, own
        more = self.rules.step_error**2 + others[:n] / self.unit[d:] ** 2
        P[np.arange(d, d + n), np.arange(d, d + n)] += more
