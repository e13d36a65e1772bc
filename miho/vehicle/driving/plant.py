"""Interface of simulated cars: plants map commands to motions."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from miho.quantities import Array
from miho.validate import settings_at_least

State = TypeVar("State")


class Command(NamedTuple):
    """Command of a controller, constant over a control period.

    Attributes
    ----------
    steering : float
        Angle of the road wheels [rad], positive to the left.
    throttle : float
        Opening from 0 to 1.
    brake : float
        Pressure of the front circuit [Pa], see `miho.vehicle.models.Brake`.
    gear : int
        Gear from 1, or 0 for neutral.
    """

    steering: float = 0.0
    throttle: float = 0.0
    brake: float = 0.0
    gear: int = 1

    def check(self, gears: int) -> None:
        """Raise ValueError unless the command is valid for a car with this number of gears."""
        for name in ("steering", "throttle", "brake", "gear"):
            value = getattr(self, name)
            if not math.isfinite(value):
                raise ValueError(f"command {name} is {value}; expected a finite number")
        if not 0 <= self.throttle <= 1:
            raise ValueError(f"command throttle is {self.throttle}; expected 0 to 1")
        if self.brake < 0:
            raise ValueError(f"command brake is {self.brake} Pa; expected at least 0")
        if self.gear not in range(gears + 1):
            raise ValueError(f"command gear is {self.gear}; expected a whole number 0 to {gears}")


class Motion(NamedTuple):
    """Motion of the car in ISO axes: x forward, y left, z up; wheels FL, FR, RL, RR.

    Attributes
    ----------
    time : float
        Time [s].
    x, y, yaw : float
        Position [m] and yaw [rad] of the centre of gravity in the plan; the yaw has no jumps.
    vx, vy, yaw_rate : float
        Velocities [m/s] and yaw rate [rad/s] in the axes of the car, along the road on a bank.
    ax, ay : float
        Forces other than weight, per mass [m/s^2], as measured by an accelerometer.
    steering : float
        Angle of the road wheels [rad].
    wheel_speeds : ndarray of shape (4,)
        Speeds of the wheels [rad/s].
    engine_speed, engine_torque : float
        Engine speed [rad/s] and torque [Nm].
    gear : int
        Gear.
    brake_pressure : float
        Pressure of the front circuit [Pa].
    loads : ndarray of shape (4,)
        Loads of the wheels [N].
    """

    time: float
    x: float
    y: float
    yaw: float
    vx: float
    vy: float
    yaw_rate: float
    ax: float
    ay: float
    steering: float
    wheel_speeds: Array
    engine_speed: float
    engine_torque: float
    gear: int
    brake_pressure: float
    loads: Array


class Plant(ABC, Generic[State]):
    """A simulated car. A plant is immutable; its methods take and return states."""

    @abstractmethod
    def start(
        self, s: float = 0.0, offset: float = 0.0, speed: float = 0.0, gear: int = 1
    ) -> State:
        """Return the state of a car that rolls along the line of the road.

        Parameters
        ----------
        s : float, optional
            Arc length of the line [m].
        offset : float, optional
            Offset to the left of the line in the plan [m].
        speed : float, optional
            Speed [m/s].
        gear : int, optional
            Gear, 0 for neutral.

        Returns
        -------
        State
            State of the plant.
        """

    @abstractmethod
    def advance(self, state: State, command: Command, duration: float) -> State:
        """Return the state after a command is held for a duration [s].

        The given state is not modified. Raises ValueError for invalid commands and durations.
        """

    @abstractmethod
    def motion(self, state: State) -> Motion:
        """Return the motion of a state, without noise."""


def steps_of(duration: float, step: float) -> int:
    """Return the number of steps in a duration; raises ValueError unless it is whole and >= 1."""
    count = duration / step if math.isfinite(duration) else math.nan
    if not (count > 0.5 and abs(count - round(count)) < 1e-6):
        raise ValueError(f"duration is {duration} s; expected a multiple of the step, {step:g} s")
    return round(count)


def channels_of(motions: Sequence[Motion], commands: Sequence[Command]) -> dict[str, Array]:
    """Return the channels of a `DrivingLog` from measured motions and their commands."""
    names = ("time", "vx", "vy", "yaw_rate", "ax", "ay", "steering", "gear", "engine_speed")
    channels = {name: np.array([getattr(row, name) for row in motions], float) for name in names}
    channels["brake"] = np.array([row.brake_pressure for row in motions])
    channels["throttle"] = np.array([command.throttle for command in commands])
    return channels


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
