"""The brake of a car: from command to force at the ground and back, and over time."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from miho.models.brake_dynamics import BrakeResponse, play
from miho.models.brake_statics import BrakePressure
from miho.quantities import Array
from miho.validate import positive, positive_settings, settings_at_least


class BrakeCommand(NamedTuple):
    """A command u [-] and the part of the demanded force that it does not give, residual [N]."""

    u: Array
    residual: Array


@dataclass(frozen=True, kw_only=True)
class Brake:
    """Two circuits on one command, as the four models identify them.

        command u -> steady pressure, front p_f = P_max ((u - u0) / (u1 - u0))^n, rear p_r
                  -> delay, lag (rising and falling)
                  -> torque of an axle T = K max(p - P0, 0)
                  -> force at the ground F = T_f / R_f + T_r / R_r

    u0, u1, n [-] and P_max [Pa]: those of `BrakePressure`, for the front circuit. bias [-]: the
    front's share of the sum of both pressures, p_r = p_f (1 - bias) / bias. K_front, K_rear
    [Nm/Pa] and P0_front, P0_rear [Pa]: those of `BrakeTorque`. radius_front, radius_rear [m]: of
    the wheels. delay, tau_rise, tau_fall [s]: those of `BrakeResponse`. hysteresis [-]: width of
    the play in the command; it acts in `respond`, while `force` and `command` are its middle.

    Forces [N] are positive when they slow the car; the tires' grip is not a limit here.
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
    hysteresis: float = 0.0

    def __post_init__(self) -> None:
        zero_allowed = ("u0", "P0_front", "P0_rear", "delay", "hysteresis")
        settings_at_least(self, zero_allowed, 0)
        positive_settings(self, [f.name for f in fields(self) if f.name not in zero_allowed])
        if self.u1 <= self.u0:
            raise ValueError(f"u1 is {self.u1}; expected above u0, which is {self.u0}")
        if self.bias >= 1:
            raise ValueError(f"bias is {self.bias}; expected between 0 and 1")
        if self.largest_force == 0:
            raise ValueError(
                f"P_max is {self.P_max}; expected above what lays on the pads of an axle"
            )

    @property
    def largest_force(self) -> float:
        """Force at and above u1 [N]."""
        return float(self.force(self.u1))

    @property
    def onset(self) -> float:
        """The command at which force begins [-]; below it is the dead band."""
        return float(self._command_of(np.asarray(min(self._contact))))

    def pressure(self, u: ArrayLike) -> tuple[Array, Array]:
        """Steady pressure of the front and of the rear circuit [Pa] at commands u [-]."""
        u = np.asarray(u, dtype=float)
        curve = np.array([[self.u0, self.u1, self.P_max, self.n]])
        front = BrakePressure().predict(curve, u.ravel()).reshape(u.shape)
        return front, front * self._rear

    def force(self, u: ArrayLike) -> Array:
        """Steady force at the ground [N] at commands u [-]."""
        return self.force_of_pressure(self.pressure(u)[0])

    def force_of_pressure(self, front: ArrayLike) -> Array:
        """Force at the ground [N] at pressures of the front circuit [Pa]."""
        p = np.asarray(front, dtype=float)
        gains = zip(self._gain, self._contact, strict=True)
        return np.asarray(sum(gain * np.maximum(p - contact, 0.0) for gain, contact in gains))

    def command(self, force: ArrayLike) -> BrakeCommand:
        """The steady command for a force [N], the inverse of `force`.

        No force, or a negative one, is the released brake (u = 0); more than the largest is u1.
        The residual is the demanded force less the one that the command gives.
        """
        F = np.asarray(force, dtype=float)
        if np.isnan(F).any():
            raise ValueError("force is NaN; expected numbers [N]")
        # The axle whose pads touch first works alone until the other's do.
        (first, k_first), (second, k_second) = sorted(zip(self._contact, self._gain, strict=True))
        alone = first + F / k_first
        both = (F + k_first * first + k_second * second) / (k_first + k_second)
        u = self._command_of(np.where(alone <= second, alone, both))
        u = np.where(F > 0, u, 0.0)
        return BrakeCommand(u, F - self.force(u))

    def respond(self, u: ArrayLike, dt: float) -> Array:
        """Pressure of the front circuit [Pa] after commands u (N,), each held for dt [s].

        Row i is the pressure at i dt; before, the brake was at rest at the first command.
        """
        u = np.asarray(u, dtype=float)
        if u.ndim != 1 or not u.size or not np.isfinite(u).all():
            raise ValueError(f"u has shape {u.shape}; expected (N,), of finite numbers")
        positive("dt", dt, "of seconds")
        target = self.pressure(play(u, self.hysteresis))[0]
        t = np.linspace(0.0, (u.size - 1) * dt, u.size)
        theta = np.array([[self.delay, self.tau_rise, self.tau_fall]])
        return np.asarray(BrakeResponse().predict(theta, t, target)[0])

    @property
    def _rear(self) -> float:
        """Pressure of the rear circuit over that of the front [-]."""
        return (1 - self.bias) / self.bias

    @property
    def _gain(self) -> tuple[float, float]:
        """Force over pressure of the front circuit [N/Pa], front and rear axle."""
        return self.K_front / self.radius_front, self.K_rear * self._rear / self.radius_rear

    @property
    def _contact(self) -> tuple[float, float]:
        """Pressure of the front circuit at which the pads touch [Pa], front and rear axle."""
        return self.P0_front, self.P0_rear / self._rear

    def _command_of(self, front: Array) -> Array:
        """The command that gives a pressure of the front circuit, at most u1."""
        share = np.clip(front / self.P_max, 0.0, 1.0)
        return np.asarray(self.u0 + (self.u1 - self.u0) * share ** (1 / self.n))
