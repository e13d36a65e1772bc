"""Lateral force over the slip angle: the tire model with offsets (Eq. 4), and with curvature."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from miho.compiled.elementary import atan, cos, sin
from miho.compiled.kernel import Formula
from miho.models.expression import Expression

OUTSIDE = 1e200
"""The exponent of a bound that does not hold."""
NEAR = 1 - 1e-9
"""Nearer to a branch point, rounding cannot tell the side: it counts as beyond."""


def _force_bound(ellipse: tuple[Any, ...], theta: tuple[Any, ...]) -> Any:
    """A bound of F_y - Sy, by |sin(u + iv)| <= exp(|v|).

    Im arctan(x + iy) = artanh(t) / 2 with t = 2y / (1 + x^2 + y^2) is harmonic, so largest on the
    ellipse itself, if that does not enclose the branch points +-i. There, at x = x_c - a cos s and
    y = b sin s, t = 2b sin s / (1 + b^2 + x_c^2 - 2 a x_c cos s + (a^2 - b^2) cos^2 s). Writing
    cos^2 s >= 2 c cos s - c^2, any c gives t^2 <= z = 4b^2 / (Q^2 - P^2). By its series, artanh(t)
    is at most t + t^3 / 3 + t^5 / (1 - t^2) / 5.
    """
    centre, width, height = ellipse
    B, C, D, Sx, _ = theta
    steep = np.abs(B)
    x, a, b = steep * np.abs(Sx - centre), steep * width, steep * height
    Q, P, foci = 1 + b * b + x * x, 2 * a * x, a * a - b * b
    c = np.minimum(P / Q, 1.0)
    Q, P = Q - foci * c * c, P - 2 * foci * c
    z = np.minimum(4 * b * b / np.maximum(Q * Q - P * P, b * b), 1.0)
    encloses = NEAR * (x * x * b * b + a * a) <= a * a * b * b
    artanh = np.sqrt(z) * (1 + z / 3 + z * z / (5 * np.maximum(1 - z, 1 - NEAR)))
    return np.abs(D), np.abs(C) * artanh / 2 + OUTSIDE * np.maximum(encloses, z >= NEAR)


def _bent_force_bound(ellipse: tuple[Any, ...], theta: tuple[Any, ...]) -> Any:
    """As `_force_bound`, for the arctangent of w = (1 - E) z + E arctan(z), in a rectangle.

    |Im w| is at most the sum of both parts', and |Re w| at least (1 - E) |Re z| - max(0, -E) pi/2,
    because the real part of arctan(z) is at most pi/2 and has the sign of that of z. For |x| >= x_0
    and |y| <= y_0, t is largest at x_0 and the lesser of y_0 and sqrt(1 + x_0^2).
    """
    centre, width, height = ellipse
    B, C, D, E, Sx, _ = theta
    steep = np.abs(B)
    x = np.maximum(steep * (np.abs(Sx - centre) - width), 0.0)
    u = 1 + x * x
    y = np.minimum(steep * height, np.sqrt(u))
    t = 2 * y / (u + y * y)
    z = t * t
    inner = t * (1 + z / 3 + z * z / (5 * np.maximum(1 - z, 1 - NEAR)))
    x_w = np.maximum((1 - E) * x - np.maximum(-E, 0.0) * (np.pi / 2), 0.0)
    u_w = 1 + x_w * x_w
    y_w = np.minimum(np.abs(1 - E) * steep * height + np.abs(E) * inner / 2, np.sqrt(u_w))
    s = 2 * y_w / (u_w + y_w * y_w)
    q = s * s
    outer = s * (1 + q / 3 + q * q / (5 * np.maximum(1 - q, 1 - NEAR)))
    return np.abs(D), np.abs(C) * outer / 2 + OUTSIDE * np.maximum(t >= NEAR, s >= NEAR)


@dataclass(frozen=True)
class Pacejka(Expression):
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
    bound = staticmethod(_force_bound)

    @property
    def value(self) -> Formula:
        """Lateral force [N]."""
        return _force

    @property
    def derivatives(self) -> Formula:
        """Derivatives of the lateral force with respect to (B, C, D, Sx, Sy)."""
        return _force_derivatives


@dataclass(frozen=True)
class PacejkaCurvature(Expression):
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
    bound = staticmethod(_bent_force_bound)

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
    return D * sin(C * atan(B * (Sx - inputs[0]))) + Sy


def _force_derivatives(inputs: tuple[Any, ...], theta: tuple[Any, ...]) -> tuple[Any, ...]:
    B, C, D, Sx, _ = theta
    slip = Sx - inputs[0]
    z = B * slip
    angle = atan(z)
    wave = sin(C * angle)
    slope = D * cos(C * angle)
    d_z = slope * C / (1 + z * z)
    return d_z * slip, slope * angle, wave, d_z * B, wave * 0 + 1


def _bent_force(inputs: tuple[Any, ...], theta: tuple[Any, ...]) -> Any:
    B, C, D, E, Sx, Sy = theta
    z = B * (Sx - inputs[0])
    return D * sin(C * atan(z - E * (z - atan(z)))) + Sy


def _bent_force_derivatives(inputs: tuple[Any, ...], theta: tuple[Any, ...]) -> tuple[Any, ...]:
    B, C, D, E, Sx, _ = theta
    slip = Sx - inputs[0]
    z = B * slip
    bend = z - atan(z)
    w = z - E * bend
    angle = atan(w)
    wave = sin(C * angle)
    slope = D * cos(C * angle)
    d_w = slope * C / (1 + w * w)
    d_z = d_w * (1 - E * z * z / (1 + z * z))
    return d_z * slip, slope * angle, wave, -d_w * bend, d_z * B, wave * 0 + 1
