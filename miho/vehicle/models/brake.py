"""Brake of a car: force at the ground for a command, and the inverse."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from miho.quantities import Array
from miho.validate import positive_settings, settings_at_least
from miho.vehicle.models.brake_statics import BrakePressure


class BrakeCommand(NamedTuple):
    """A command of the brake, and the force that it lacks.

    Attributes
    ----------
    u : ndarray
        Commands [-], of the shape of the demanded forces.
    residual : ndarray
        Demanded force minus the force of the command [N].
    """

    u: Array
    residual: Array


@dataclass(frozen=True, kw_only=True)
class Brake:
    """Brake with two circuits and one command, composed of the identified brake models.

        command u -> steady pressure, front p_f = P_max ((u - u0) / (u1 - u0))^n, rear p_r
                  -> delay, lag (rising and falling)
                  -> torque of an axle T = K max(p - P0, 0)
                  -> force at the ground F = T_f / R_f + T_r / R_r

    Forces [N] are positive if they slow the car. The grip of the tires does not limit them.

    Parameters
    ----------
    u0, u1, P_max, n : float
        Parameters of `BrakePressure` for the front circuit: [-], [-], [Pa], [-].
    bias : float
        Share of the front in the sum of both pressures [-]: p_r = p_f (1 - bias) / bias.
    K_front, P0_front, K_rear, P0_rear : float
        Parameters of `BrakeTorque` for each axle: K [Nm/Pa], P0 [Pa].
    radius_front, radius_rear : float
        Radii of the wheels [m].
    delay, tau_rise, tau_fall : float
        Parameters of `BrakeResponse` [s].

    Raises
    ------
    ValueError
        If a parameter is out of range, or if the brake cannot produce a force.
    """

    u0: float
    u1: float
    P_max: float
    n: float
    bias: float
    K_front: float
    P0_front: float
    K_rear: float
    P0_rear: float
    radius_front: float
    radius_rear: float
    delay: float = 0.0
    tau_rise: float
    tau_fall: float

    def __post_init__(self) -> None:
        zero_allowed = ("u0", "P0_front", "P0_rear", "delay")
        settings_at_least(self, zero_allowed, 0)
        positive_settings(self, [f.name for f in fields(self) if f.name not in zero_allowed])
        if self.u1 <= self.u0:
            raise ValueError(f"u1 is {self.u1}; expected above u0, which is {self.u0}")
        if self.bias >= 1:
            raise ValueError(f"bias is {self.bias}; expected between 0 and 1")
        if self.largest_force == 0:
            raise ValueError(
                f"P_max is {self.P_max}; expected above the pressure at which the pads of an "
                "axle touch"
            )

    @property
    def largest_force(self) -> float:
        """Force at and above u1 [N]."""
        return float(self.force(self.u1))

    def pressure(self, u: ArrayLike) -> tuple[Array, Array]:
        """Return the steady pressures of the front and rear circuit [Pa] at commands u [-]."""
        u = np.asarray(u, dtype=float)
        curve = np.array([[self.u0, self.u1, self.P_max, self.n]])
        front = BrakePressure().predict(curve, u.ravel()).reshape(u.shape)
        return front, front * self._rear

    def force(self, u: ArrayLike) -> Array:
        """Return the steady force at the ground [N] at commands u [-]."""
        return self.force_of_pressure(self.pressure(u)[0])

    def force_of_pressure(self, front: ArrayLike) -> Array:
        """Return the force at the ground [N] at pressures of the front circuit [Pa]."""
        p = np.asarray(front, dtype=float)
        gains = zip(self._gain, self._contact, strict=True)
        return np.asarray(sum(gain * np.maximum(p - contact, 0.0) for gain, contact in gains))

    def command(self, force: ArrayLike) -> BrakeCommand:
        """Return the steady command for a force [N], the inverse of `force`.

        A force of 0 or below gives the released brake (u = 0), and a force above the largest one
        gives u1. The residual is the demanded force minus the force of the command.
        """
        F = np.asarray(force, dtype=float)
        if np.isnan(F).any():
            raise ValueError("force is NaN; expected numbers [N]")
        # One axle works alone until the pads of the other axle touch.
        (first, k_first), (second, k_second) = sorted(zip(self._contact, self._gain, strict=True))
        alone = first + F / k_first
        both = (F + k_first * first + k_second * second) / (k_first + k_second)
        u = self._command_of(np.where(alone <= second, alone, both))
        u = np.where(F > 0, u, 0.0)
        return BrakeCommand(u, F - self.force(u))

    @property
    def _rear(self) -> float:
        """Ratio of the rear to the front pressure [-]."""
        return (1 - self.bias) / self.bias

    @property
    def _gain(self) -> tuple[float, float]:
        """Force of the front and rear axle per pressure of the front circuit [N/Pa]."""
        return self.K_front / self.radius_front, self.K_rear * self._rear / self.radius_rear

    @property
    def _contact(self) -> tuple[float, float]:
        """Pressure of the front circuit at which the pads touch [Pa], front and rear axle."""
        return self.P0_front, self.P0_rear / self._rear

    def _command_of(self, front: Array) -> Array:
        """Return the command for a pressure of the front circuit, at most u1."""
        share = np.clip(front / self.P_max, 0.0, 1.0)
        return np.asarray(self.u0 + (self.u1 - self.u0) * share ** (1 / self.n))
