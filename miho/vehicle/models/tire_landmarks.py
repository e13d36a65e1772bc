"""Tire curve in terms of features of its plot: slope, peak and asymptote."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from miho.models.derived import Derived
from miho.models.model import Model
from miho.quantities import Array
from miho.vehicle.models.features import tire_features
from miho.vehicle.models.tire import PacejkaCurvature


@dataclass(frozen=True)
class PacejkaLandmarks(Model):
    """`PacejkaCurvature` in terms of its slope, peak and asymptote.

        C = 2 - (2 / pi) arcsin(y_a / D)     B = K / (C D)
        E = (B x_m - tan(pi / (2 C))) / (B x_m - arctan(B x_m))

    The parameter K [N/rad] is the slope -dF_y/dalpha at alpha = Sx, positive. D and y_a [N] are
    the peak and the asymptote of the force minus Sy. x_m [rad] is the distance of the peak from
    Sx. Sx [rad] and Sy [N] are as in `Pacejka`.

    Some parameters have no curve: the asymptote must not exceed the peak (y_a <= D), and E must be
    at most 1. Otherwise `predict` and `jacobian` give NaN.

    References
    ----------
    Pacejka, Tire and Vehicle Dynamics, 3rd ed. (2012), Sec. 4.3.1.
    """

    inputs = PacejkaCurvature.inputs
    parameters = MappingProxyType(
        {"K": "N/rad", "D": "N", "y_a": "N", "x_m": "rad", "Sx": "rad", "Sy": "N"}
    )
    output = PacejkaCurvature.output
    linear = ("Sy",)

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Lateral force [N], (n, N), NaN for parameters without a curve."""
        return PacejkaCurvature().predict(factors(thetas), *inputs)

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the force with respect to (K, D, y_a, x_m, Sx, Sy), (N, 6)."""
        at = factors(theta[None])[0]
        if np.isnan(at).any():
            return np.full((inputs[0].size, theta.size), np.nan)
        return PacejkaCurvature().jacobian(at, *inputs) @ _factor_slopes(theta, at)

    def derived_quantities(self, columns: Mapping[str, Array]) -> tuple[Derived, ...]:
        """Return cornering stiffness, peaks and friction."""
        return tire_features(self, columns)


def factors(thetas: Array) -> Array:
    """Return (B, C, D, E, Sx, Sy) for rows (K, D, y_a, x_m, Sx, Sy); NaN if E > 1 or y_a > D."""
    K, D, y_a, x_m, Sx, Sy = thetas.T
    with np.errstate(invalid="ignore"):
        C = 2 - 2 / np.pi * np.arcsin(y_a / D)
    B = K / (C * D)
    z = B * x_m
    E = (z - np.tan(np.pi / (2 * C))) / (z - np.arctan(z))
    return np.stack([B, C, D, np.where(E <= 1, E, np.nan), Sx, Sy], axis=1)


def _factor_slopes(theta: Array, at: Array) -> Array:
    """Derivatives of (B, C, D, E, Sx, Sy) with respect to (K, D, y_a, x_m, Sx, Sy), (6, 6)."""
    K, D, y_a, x_m = theta[:4]
    B, C, _, E = at[:4]
    z, T = B * x_m, np.tan(np.pi / (2 * C))
    bend = z - np.arctan(z)
    by_z = (1 - E * z * z / (1 + z * z)) / bend
    by_C = (1 + T * T) * np.pi / (2 * C * C) / bend
    slopes = np.zeros((6, 6))
    slopes[1, 2] = -2 / np.pi / np.sqrt(D * D - y_a * y_a)
    slopes[1, 1] = -slopes[1, 2] * y_a / D
    slopes[0, 0] = B / K
    slopes[0, 1] = -B / D - B / C * slopes[1, 1]
    slopes[0, 2] = -B / C * slopes[1, 2]
    slopes[3] = by_z * x_m * slopes[0] + by_C * slopes[1]
    slopes[3, 3] = by_z * B
    slopes[2, 1] = slopes[4, 4] = slopes[5, 5] = 1.0
    return slopes
