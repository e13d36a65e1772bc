"""Manoeuvres for the identification of a car: weaves and constant pedals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np

from miho.validate import settings_at_least
from miho.vehicle.data.driving_log import DrivingLog
from miho.vehicle.driving.plant import Command, Motion, Plant, Sensors, channels_of
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.models.engine import RPM

State = TypeVar("State")

PERIOD = 0.01
"""Time from one command, and sample, to the next [s]."""
LEAD = 0.5
"""Time of rolling before a pedal is pressed [s], so that a log shows the step."""
SLOWEST, FASTEST = 1500 * RPM, 6800 * RPM
"""Range of engine speeds with a constant opening [rad/s]."""
HELD_GEARS = (2, 3, 4)
WEAVE_SPEEDS = (25.0, 35.0, 45.0)
BRAKE_SPEEDS = (30.0, 60.0)
BRAKE_PRESSURES = (0.5e6, 1.0e6, 1.5e6, 2.0e6, 3.0e6)
SLIDING = 0.15
"""Ratio of lateral to longitudinal speed [-] at which a manoeuvre ends, because the car spins."""


@dataclass(frozen=True, kw_only=True)
class Manoeuvre:
    """Open-loop driving on a plane, until the duration ends, the speed leaves a range, or a spin.

    Throttle and brake are constant after the first `LEAD` [s]. Steering is a sine whose amplitude
    rises linearly from 0; the throttle then approximately keeps the speed.
    """

    speed: float  # at the start [m/s]
    gear: int  # 0 for neutral
    duration: float  # the largest [s]
    within: tuple[float, float] = (5.0, 90.0)  # range of the speed [m/s]
    throttle: float = 0.0  # opening from 0 to 1
    brake: float = 0.0  # front pressure [Pa]
    steering: float = 0.0  # final amplitude [rad]
    frequency: float = 0.4  # of the sine [Hz]

    def __post_init__(self) -> None:
        settings_at_least(self, [f.name for f in fields(self) if f.name != "within"], 0)
        low, high = self.within
        if not 0 < low <= self.speed <= high:
            raise ValueError(f"speed is {self.speed} m/s; expected {low:g} to {high:g} m/s, within")

    def command(self, t: float, vx: float) -> Command:
        """Return the command at a time since the start [s] and a speed [m/s]."""
        if self.steering > 0:
            swing = self.steering * t / self.duration * math.sin(math.tau * self.frequency * t)
            throttle = min(max(0.25 + 0.1 * (self.speed - vx), 0.0), 1.0)
            return Command(swing, throttle, 0.0, self.gear)
        pressed = t >= LEAD
        return Command(0.0, self.throttle * pressed, self.brake * pressed, self.gear)


@dataclass(frozen=True, eq=False)
class Recording:
    """Motions without noise, and commands, of a driven manoeuvre, with a row per `PERIOD`."""

    motions: tuple[Motion, ...]
    commands: tuple[Command, ...]

    def log(self, name: str, sensors: Sensors, rng: np.random.Generator) -> DrivingLog:
        """Return the log of sensors, with noise from `rng`."""
        rows = [sensors.measure(motion, rng) for motion in self.motions]
        channels = channels_of(rows, self.commands)
        channels["time"] = np.asarray(PERIOD * np.arange(len(rows)))
        return DrivingLog(name, channels)


def perform(plant: Plant[State], manoeuvre: Manoeuvre) -> Recording:
    """Drive a manoeuvre on a plane.

    Parameters
    ----------
    plant : Plant
        The car.
    manoeuvre : Manoeuvre
        An entry of `programme`.

    Returns
    -------
    Recording
        Motions and commands; its `log` adds the noise of sensors.
    """
    state = plant.start(speed=manoeuvre.speed, gear=manoeuvre.gear)
    motions, commands = [], []
    low, high = manoeuvre.within
    for k in range(round(manoeuvre.duration / PERIOD)):
        motion = plant.motion(state)
        if not low <= motion.vx <= high or abs(motion.vy) > SLIDING * motion.vx:
            break
        command = manoeuvre.command(k * PERIOD, motion.vx)
        motions.append(motion)
        commands.append(command)
        state = plant.advance(state, command, PERIOD)
    return Recording(tuple(motions), tuple(commands))


def weaves() -> tuple[Manoeuvre, ...]:
    """Return manoeuvres for the axles, beyond the peaks of the tires, at three speeds."""
    first = Manoeuvre(speed=WEAVE_SPEEDS[0], gear=2, duration=20.0, steering=0.16)
    return tuple(
        replace(first, speed=speed, gear=gear) for gear, speed in enumerate(WEAVE_SPEEDS, start=2)
    )


def held_throttles(
    vehicle: Vehicle, throttle: float, gears: Sequence[int] = HELD_GEARS, longest: float = 14.0
) -> tuple[Manoeuvre, ...]:
    """Return manoeuvres for the engine: an opening from high and low speed in each gear."""
    manoeuvres = []
    for gear in gears:
        lever = vehicle.gear_ratios[gear - 1] * vehicle.final_drive / vehicle.wheel_radius
        low, high = SLOWEST / lever, FASTEST / lever
        for speed in (0.99 * high, 1.1 * low):
            manoeuvre = Manoeuvre(
                speed=speed, gear=gear, duration=longest, within=(0.9 * low, 1.01 * high),
                throttle=throttle,
            )  # fmt: skip
            manoeuvres.append(manoeuvre)
    return tuple(manoeuvres)


def brakings() -> tuple[Manoeuvre, ...]:
    """Return manoeuvres for the brake: constant pressures in neutral, without engine braking."""
    return tuple(
        Manoeuvre(speed=speed, gear=0, duration=6.0, within=(10.0, 90.0), brake=pressure)
        for speed in BRAKE_SPEEDS
        for pressure in BRAKE_PRESSURES
    )


def programme(vehicle: Vehicle, openings: Sequence[float]) -> Mapping[str, tuple[Manoeuvre, ...]]:
    """Return the manoeuvres from which all parts of a car are identified.

    Parameters
    ----------
    vehicle : Vehicle
        Masses and dimensions of the car.
    openings : sequence of float
        Throttle openings to hold, from 0 to 1.

    Returns
    -------
    mapping of str to tuple of Manoeuvre
        Manoeuvres by name: weave, braking, and throttle_05 etc. for the openings.
    """
    throttles = {
        f"throttle_{round(100 * opening):02d}": held_throttles(vehicle, opening)
        for opening in openings
    }
    return {"weave": weaves(), "braking": brakings(), **throttles}
