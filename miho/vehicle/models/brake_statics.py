"""Steady brake: pressure over command, torque over pressure, deceleration over pressure.

The paper does not describe its brake model. These are common models of automated vehicles
(Hedrick et al. 1997, Raza et al. 1997). Each model is identified separately; `Brake` composes them.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from miho.models.model import Model
from miho.quantities import Array


@dataclass(frozen=True)
class BrakePressure(Model):
    """Steady pressure p [Pa] of a circuit over the brake command u [-].

        p = P_max ((u - u0) / (u1 - u0))^n,   0 below u0, P_max above u1

    The pressure rises between the commands u0 < u1 [-], and n > 0 [-] is the curvature exponent.
    Data below u1 cannot separate u1 from P_max [Pa]: they determine P_max / (u1 - u0)^n only.
    """

    inputs = MappingProxyType({"u": "-"})
    parameters = MappingProxyType({"u0": "-", "u1": "-", "P_max": "Pa", "n": "-"})
    output = "Pa"
    linear = ("P_max",)

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Pressure [Pa], (n, N)."""
        (u,) = inputs
        u0, u1, P_max, n = thetas.T[:, :, None]
        return np.asarray(P_max * np.clip((u - u0) / (u1 - u0), 0.0, 1.0) ** n)

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the pressure with respect to (u0, u1, P_max, n), (N, 4).

        At the two kinks, u = u0 and u = u1, they are the derivatives of the constant side.
        """
        (u,) = inputs
        u0, u1, P_max, n = theta
        span = u1 - u0
        x = (u - u0) / span
        J = np.zeros((u.size, 4))
        J[x >= 1, 2] = 1.0
        rising = (x > 0) & (x < 1)
        x = x[rising]
        share = x**n
        slope = P_max * n * share / x / span
        J[rising] = np.stack(
            [slope * (x - 1), -slope * x, share, P_max * share * np.log(x)], axis=1
        )
        return J


@dataclass(frozen=True)
class BrakeTorque(Model):
    """Brake torque T [Nm] of an axle, both wheels, over the pressure p [Pa] in its circuit.

        T = K max(p - P0, 0)

    The gain K [Nm/Pa] combines pistons, pads, disc and friction. P0 [Pa] is the pressure at which
    the pads touch the disc. T is positive if it slows the wheels.
    """

    inputs = MappingProxyType({"p": "Pa"})
    parameters = MappingProxyType({"K": "Nm/Pa", "P0": "Pa"})
    output = "Nm"
    linear = ("K",)

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Torque [Nm], (n, N)."""
        (p,) = inputs
        K, P0 = thetas.T[:, :, None]
        return np.asarray(K * np.maximum(p - P0, 0.0))

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the torque with respect to (K, P0), (N, 2)."""
        (p,) = inputs
        K, P0 = theta
        return np.stack([np.maximum(p - P0, 0.0), np.where(p > P0, -K, 0.0)], axis=1)


@dataclass(frozen=True)
class BrakeDeceleration(Model):
    """Deceleration -dvx/dt [m/s^2] of a braking car, positive if it slows down.

        deceleration = c_p p + c_v vx^2 + c_0

    c_p [m/s^2/Pa] times the mass is the brake force at the ground per pressure p [Pa]. c_v [1/m]
    is the drag. c_0 [m/s^2] is rolling resistance and engine drag, minus the effect of P0. The
    model is valid with closed throttle, touching pads (p > P0) and on level ground.
    """

    inputs = MappingProxyType({"p": "Pa", "vx": "m/s"})
    parameters = MappingProxyType({"c_p": "m/s^2/Pa", "c_v": "1/m", "c_0": "m/s^2"})
    output = "m/s^2"
    linear = ("c_p", "c_v", "c_0")

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Deceleration [m/s^2], (n, N)."""
        p, vx = inputs
        c_p, c_v, c_0 = thetas.T[:, :, None]
        return np.asarray(c_p * p + c_v * (vx * vx) + c_0)

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the deceleration with respect to (c_p, c_v, c_0), (N, 3)."""
        p, vx = inputs
        return np.stack([p, vx * vx, np.ones_like(p)], axis=1)
