"""Measurement noise of the motion that controllers use."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from miho.validate import settings_at_least
from miho.vehicle.driving.plant import Motion


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """White noise of each channel of a `Motion`, as standard deviations in SI units.

    Time and gear are exact. The defaults are typical values, chosen for this package, of a good
    inertial unit with GNSS (RTK) and of the wheel and engine sensors of a racing car.

    Parameters
    ----------
    position : float, optional
        Noise of x and of y [m].
    yaw, vx, vy, yaw_rate, ax, ay, steering : float, optional
        Noise of the channel of this name [rad], [m/s], [m/s], [rad/s], [m/s^2], [m/s^2], [rad].
    wheel_speeds, engine_speed, engine_torque, brake_pressure, loads : float, optional
        Noise of the channel of this name [rad/s], [rad/s], [Nm], [Pa], [N].

    Raises
    ------
    ValueError
        If a standard deviation is below 0.
    """

    position: float = 0.02
    yaw: float = 0.002
    vx: float = 0.05
    vy: float = 0.05
    yaw_rate: float = 0.005
    ax: float = 0.2
    ay: float = 0.2
    steering: float = 0.001
    wheel_speeds: float = 0.1
    engine_speed: float = 1.0
    engine_torque: float = 2.0
    brake_pressure: float = 1.5e4
    loads: float = 30.0

    def __post_init__(self) -> None:
        settings_at_least(self, [field.name for field in fields(self)], 0)

    def measure(self, motion: Motion, rng: np.random.Generator) -> Motion:
        """Return the motion with noise; each call draws the same number of values from `rng`."""
        stds = {"x": self.position, "y": self.position}
        stds |= {field.name: getattr(self, field.name) for field in fields(self)[1:]}
        measured: dict[str, Any] = {}
        for name, std in stds.items():
            value = getattr(motion, name)
            measured[name] = value + std * rng.standard_normal(np.shape(value) or None)
        return motion._replace(**measured)
