"""Lateral force over the slip angle: the tire model with offsets (Eq. 4), and with curvature."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from miho.models.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pacejka(Model):
    """Lateral force F_y [N] over the slip angle alpha [rad], ISO-W: F_y falls as alpha grows.

        F_y = D sin(C arctan(B (Sx - alpha))) + Sy

    This is Eq. 4 with the paper's slip angle, which is -alpha in ISO-W, so that B [1/rad],
    C [-] and D [N] are positive. Sx [rad] shifts the curve along alpha and Sy [N] along F_y:
    the force is Sy at alpha = Sx.
    """

    inputs = MappingProxyType({"alpha": "rad"})
    parameters = MappingProxyType({"B": "1/rad", "C": "-", "D": "N", "Sx": "rad", "Sy": "N"})
    output = "N"
    linear = ("D", "Sy")

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Lateral force [N], (n, N)."""
        (alpha,) = inputs
        B, C, D, Sx, Sy = thetas.T[:, :, None]
        F = Sx - alpha
        F *= B
        np.arctan(F, out=F)
        F *= C
        np.sin(F, out=F)
        F *= D
        F += Sy
        return np.asarray(F)

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the lateral force with respect to (B, C, D, Sx, Sy), (N, 5)."""
        (alpha,) = inputs
        B, C, D, Sx, _ = theta
        slip = Sx - alpha
        z = B * slip
        angle = np.arctan(z)
        slope = D * np.cos(C * angle)
        d_z = slope * C / (1 + z * z)
        J = np.empty((alpha.size, 5))
        J[:, 0] = d_z * slip
        J[:, 1] = slope * angle
        J[:, 2] = np.sin(C * angle)
        J[:, 3] = d_z * B
        J[:, 4] = 1.0
        return J


@dataclass(frozen=True)
class PacejkaCurvature(Model):
    """`Pacejka` with the Magic Formula's curvature factor E [-], which bends the curve at its peak.

        F_y = D sin(C arctan(z - E (z - arctan(z)))) + Sy,   z = B (Sx - alpha)

    E = 0 is `Pacejka`; the slope at alpha = Sx is B C D for every E. The curve is meant for
    E <= 1: above, it turns back on itself at large slip.
    """

    inputs = MappingProxyType({"alpha": "rad"})
    parameters = MappingProxyType(
        {"B": "1/rad", "C": "-", "D": "N", "E": "-", "Sx": "rad", "Sy": "N"}
    )
    output = "N"
    linear = ("D", "Sy")

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Lateral force [N], (n, N)."""
        (alpha,) = inputs
        B, C, D, E, Sx, Sy = thetas.T[:, :, None]
        z = Sx - alpha
        z *= B
        F = np.arctan(z)
        F -= z
        F *= E
        F += z
        np.arctan(F, out=F)
        F *= C
        np.sin(F, out=F)
        F *= D
        F += Sy
        return np.asarray(F)

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the lateral force with respect to (B, C, D, E, Sx, Sy), (N, 6).

        A batch of parameters (n, 6) gives (n, N, 6).
        """
        (alpha,) = inputs
        B, C, D, E, Sx, _ = np.moveaxis(theta, -1, 0)[..., None]
        slip = Sx - alpha
        z = B * slip
        bend = z - np.arctan(z)
        w = z - E * bend
        angle = np.arctan(w)
        d_w = D * np.cos(C * angle) * C / (1 + w * w)
        d_z = d_w * (1 - E * z * z / (1 + z * z))
        J = np.empty((*z.shape, 6))
        J[..., 0] = d_z * slip
        J[..., 1] = D * np.cos(C * angle) * angle
        J[..., 2] = np.sin(C * angle)
        J[..., 3] = -d_w * bend
        J[..., 4] = d_z * B
        J[..., 5] = 1.0
        return J
