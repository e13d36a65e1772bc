"""Drives whose measurements the car's parameters are identified from: weaves, held pedals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np

from miho.data.driving_log import DrivingLog
from miho.driving.plant import Command, Motion, Plant
from miho.driving.sensors import Sensors
from miho.driving.vehicle import Vehicle
from miho.models.engine import RPM
from miho.validate import settings_at_least

State = TypeVar("State")

PERIOD = 0.01
"""Time from one command, and sample, to the next [s]."""
LEAD = 0.5
"""How long the car rolls before a pedal is pressed, so that a log shows when it was [s]."""
MEASURED = ("time", "vx", "vy", "yaw_rate", "ax", "ay", "steering", "gear", "engine_speed")
SLOWEST, FASTEST = 1500 * RPM, 6800 * RPM
"""Engine speeds between which an opening is held [rad/s]."""
HELD_GEARS = (2, 3, 4)
WEAVE_SPEEDS = (25.0, 35.0, 45.0)
BRAKE_SPEEDS = (30.0, 60.0)
BRAKE_PRESSURES = (0.5e6, 1.0e6, 1.5e6, 2.0e6, 3.0e6)
SLIDING = 0.15
"""Lateral over longitudinal speed [-] at which the driver gives up: the car begins to spin."""


@dataclass(frozen=True, kw_only=True)
class Manoeuvre:
    """One stretch of open-loop driving on a plane, from a speed [m/s] in a gear, 0 for neutral.

    It lasts for `duration` [s] or until the speed leaves `within` [m/s] or the car spins. throttle
    and brake (front pressure [Pa]) are held after the first `LEAD` [s]. The steering [rad] is a
    sine of `frequency` [Hz] whose amplitude rises evenly from 0 to `steering`; while it weaves the
    throttle holds the speed as well as a driver would.
    """

    speed: float
    gear: int
    duration: float
    within: tuple[float, float] = (5.0, 90.0)
    throttle: float = 0.0
    brake: float = 0.0
    steering: float = 0.0
    frequency: float = 0.4

    def __post_init__(self) -> None:
        settings_at_least(self, [f.name for f in fields(self) if f.name != "within"], 0)
        low, high = self.within
        if not 0 < low <= self.speed <= high:
            raise ValueError(f"speed is {self.speed} m/s; expected {low:g} to {high:g} m/s, within")

    def command(self, t: float, vx: float) -> Command:
        """What is commanded at a time [s] since the start, at a speed [m/s]."""
        if self.steering > 0:
            swing = self.steering * t / self.duration * math.sin(math.tau * self.frequency * t)
            throttle = min(max(0.25 + 0.1 * (self.speed - vx), 0.0), 1.0)
            return Command(swing, throttle, 0.0, self.gear)
        pressed = t >= LEAD
        return Command(0.0, self.throttle * pressed, self.brake * pressed, self.gear)


@dataclass(frozen=True, eq=False)
class Recording:
    """A manoeuvre as it was driven, a row each `PERIOD`: motions without noise, and commands."""

    motions: tuple[Motion, ...]
    commands: tuple[Command, ...]

    def log(self, name: str, sensors: Sensors, rng: np.random.Generator) -> DrivingLog:
        """The log that sensors make of it, with their noise drawn from `rng`."""
        rows = [sensors.measure(motion, rng) for motion in self.motions]
        channels = {key: np.array([getattr(row, key) for row in rows], float) for key in MEASURED}
        channels["time"] = PERIOD * np.arange(len(rows))
        channels["brake"] = np.array([row.brake_pressure for row in rows])
        channels["throttle"] = np.array([command.throttle for command in self.commands])
        return DrivingLog(name, channels)


def perform(plant: Plant[State], manoeuvre: Manoeuvre) -> Recording:
    """Drive a manoeuvre on a plane."""
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
    """For the axles: up to and beyond the tires' peaks, at three speeds."""
    first = Manoeuvre(speed=WEAVE_SPEEDS[0], gear=2, duration=20.0, steering=0.16)
    return tuple(
        replace(first, speed=speed, gear=gear) for gear, speed in enumerate(WEAVE_SPEEDS, start=2)
    )


def held_throttles(
    vehicle: Vehicle, throttle: float, gears: Sequence[int] = HELD_GEARS, longest: float = 14.0
) -> tuple[Manoeuvre, ...]:
    """For the engine: an opening held from high and from low engine speeds, in each gear."""
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
    """For the brake: constant pressures in neutral, so that the engine does not brake too."""
    return tuple(
        Manoeuvre(speed=speed, gear=0, duration=6.0, within=(10.0, 90.0), brake=pressure)
        for speed in BRAKE_SPEEDS
        for pressure in BRAKE_PRESSURES
    )


def programme(vehicle: Vehicle, openings: Sequence[float]) -> Mapping[str, tuple[Manoeuvre, ...]]:
    """All that is driven, by name: weave, braking, and throttle_05 and so on for the openings."""
    throttles = {
        f"throttle_{round(100 * opening):02d}": held_throttles(vehicle, opening)
        for opening in openings
    }
    return {"weave": weaves(), "braking": brakings(), **throttles}
