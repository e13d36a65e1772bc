"""Lateral force over the slip angle: the tire model with offsets (Eq. 4), and with curvature.

The latter also in terms of features of its plot: slope, peak and asymptote.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from miho.compiled.kernel import Formula
from miho.models.derived import Derived
from miho.models.expression import Expression
from miho.models.model import Model
from miho.quantities import Array
from miho.vehicle.models.features import tire_features


class _OverSlipAngle(Expression):
    """A lateral force [N] over the slip angle alpha [rad], in ISO-W signs."""

    inputs = MappingProxyType({"alpha": "rad"})
    output = "N"
    linear = ("D", "Sy")

    def derived_quantities(self, columns: Mapping[str, Array]) -> tuple[Derived, ...]:
        """Return cornering stiffness, peaks and friction."""
        return tire_features(self, columns)

    def check_data(
        self,
        inputs: Mapping[str, Array],
        output: Array,
        convention: str,
        ranges: Mapping[str, Sequence[float] | None] | None,
        largest: Mapping[str, float],
    ) -> None:
        """Raise ValueError for slip angles in degrees, and for a force that rises with them.

        The force may rise if B, C or D cannot be positive. The size of the force is checked only by
        `ranges`, since it may be divided by the load.
        """
        from miho.vehicle.models.iso_w import check_iso_w

        falls = all(largest.get(name, np.inf) > 0 for name in ("B", "C", "D"))
        ranges = {"Fy": None, **(ranges or {})}
        check_iso_w(inputs, ["rad", "N"], "Fy", output, convention, ranges, signs=falls)

    def converted(
        self, inputs: Mapping[str, Array], output: Array, convention: str
    ) -> tuple[dict[str, Array], Array]:
        """Return slip angle and force (N,) in ISO-W signs."""
        from miho.vehicle.models.iso_w import in_iso_w

        return in_iso_w(inputs, "Fy", output, convention)

    def check_signs(self, inputs: Mapping[str, Array]) -> None:
        """Accept all slip angles, because their sign is not known without the force."""


@dataclass(frozen=True)
class Pacejka(_OverSlipAngle):
    """Lateral force F_y [N] over the slip angle alpha [rad], ISO-W: F_y falls as alpha grows.

        F_y = D sin(C arctan(B (Sx - alpha))) + Sy

    This is Eq. 4 with the paper's slip angle, which is -alpha in ISO-W, so B [1/rad], C [-] and
    D [N] are positive. Sx [rad] shifts the curve along alpha, and Sy [N] shifts it along F_y: the
    force is Sy at alpha = Sx. A fit refuses a force that rises with alpha, unless the bounds of B,
    C or D end at 0 or below.

    Examples
    --------
    >>> import numpy as np
    >>> theta = np.array([[10.0, 1.5, 4000.0, 0.0, 50.0]])
    >>> Pacejka().predict(theta, np.array([0.0, 0.05])).round(1).tolist()
    [[50.0, -2513.0]]
    """

    parameters = MappingProxyType({"B": "1/rad", "C": "-", "D": "N", "Sx": "rad", "Sy": "N"})

    @property
    def value(self) -> Formula:
        """Lateral force [N]."""
        return _force

    @property
    def derivatives(self) -> Formula:
        """Derivatives of the lateral force with respect to (B, C, D, Sx, Sy)."""
        return _force_derivatives


@dataclass(frozen=True)
class PacejkaCurvature(_OverSlipAngle):
    """`Pacejka` with the Magic Formula's curvature factor E [-], which bends the curve at its peak.

        F_y = D sin(C arctan(z - E (z - arctan(z)))) + Sy,   z = B (Sx - alpha)

    E = 0 gives `Pacejka`. The slope at alpha = Sx is -B C D for every E. Use E <= 1: with larger
    values the force changes its sign again at large slip.
    """

    parameters = MappingProxyType(
        {"B": "1/rad", "C": "-", "D": "N", "E": "-", "Sx": "rad", "Sy": "N"}
    )

    @property
    def value(self) -> Formula:
        """Lateral force [N]."""
        return _bent_force

    @property
    def derivatives(self) -> Formula:
        """Derivatives of the lateral force with respect to (B, C, D, E, Sx, Sy)."""
        return _bent_force_derivatives


def _force(inputs: tuple[Any, ...], theta: tuple[Any, ...]) -> Any:
    B, C, D, Sx, Sy = theta
    return D * np.sin(C * np.arctan(B * (Sx - inputs[0]))) + Sy


def _force_derivatives(inputs: tuple[Any, ...], theta: tuple[Any, ...]) -> tuple[Any, ...]:
    B, C, D, Sx, _ = theta
    slip = Sx - inputs[0]
    z = B * slip
    angle = np.arctan(z)
    wave = np.sin(C * angle)
    slope = D * np.cos(C * angle)
    d_z = slope * C / (1 + z * z)
    return d_z * slip, slope * angle, wave, d_z * B, wave * 0 + 1


def _bent_force(inputs: tuple[Any, ...], theta: tuple[Any, ...]) -> Any:
    B, C, D, E, Sx, Sy = theta
    z = B * (Sx - inputs[0])
    return D * np.sin(C * np.arctan(z - E * (z - np.arctan(z)))) + Sy


def _bent_force_derivatives(inputs: tuple[Any, ...], theta: tuple[Any, ...]) -> tuple[Any, ...]:
    B, C, D, E, Sx, _ = theta
    slip = Sx - inputs[0]
    z = B * slip
    bend = z - np.arctan(z)
    w = z - E * bend
    angle = np.arctan(w)
    wave = np.sin(C * angle)
    slope = D * np.cos(C * angle)
    d_w = slope * C / (1 + w * w)
    d_z = d_w * (1 - E * z * z / (1 + z * z))
    return d_z * slip, slope * angle, wave, -d_w * bend, d_z * B, wave * 0 + 1


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
