"""What is driven: a plant takes commands and says how the car moves."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Generic, NamedTuple, TypeVar

from miho.quantities import Array

State = TypeVar("State")


class Command(NamedTuple):
    """What a controller asks for, held over a control period.

    steering: angle of the road wheels [rad], positive to the left. throttle: 0 to 1. brake:
    pressure of the front circuit [Pa], as `miho.models.Brake` has it. gear: 1 up, or 0 for neutral.
    """

    steering: float = 0.0
    throttle: float = 0.0
    brake: float = 0.0
    gear: int = 1

    def check(self, gears: int) -> None:
        """Raise ValueError unless every part is a command that a car with so many gears takes."""
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
    """How the car moves, ISO axes: x forward, y left, z up. Wheels: FL, FR, RL, RR.

    time [s]; x, y [m] and yaw [rad]: of the centre of gravity, seen from above, the yaw without
    jumps; vx, vy [m/s] and yaw_rate [rad/s]: about the car's own axes, on a bank along the road;
    ax, ay [m/s^2]: forces other than weight, per mass, as an accelerometer feels them; steering:
    angle of the road wheels [rad]; wheel_speeds (4,) and engine_speed [rad/s]; engine_torque [Nm];
    brake_pressure of the front circuit [Pa]; loads (4,): of the wheels [N].
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
    """A simulated car. It holds no state: what moves is in the states that it makes."""

    @abstractmethod
    def start(
        self, s: float = 0.0, offset: float = 0.0, speed: float = 0.0, gear: int = 1
    ) -> State:
        """The car running straight along the road's line, rolling at a speed [m/s].

        s: arc length of the line [m]; offset: to the left of it in the plan [m].
        """

    @abstractmethod
    def advance(self, state: State, command: Command, duration: float) -> State:
        """The state after a command was held for a duration [s]; the given state is unchanged.

        Raises ValueError for a command or duration that is not finite or not allowed.
        """

    @abstractmethod
    def motion(self, state: State) -> Motion:
        """What can be seen of a state, without noise."""


def steps_of(duration: float, step: float) -> int:
    """The number of steps [s] in a duration [s]; ValueError unless whole and at least 1."""
    count = duration / step if math.isfinite(duration) else math.nan
    if not (count > 0.5 and abs(count - round(count)) < 1e-6):
        raise ValueError(f"duration is {duration} s; expected a multiple of the step, {step:g} s")
    return round(count)
