"""Plants for the tests of this folder, and what they do under one command."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import numpy as np

from miho.vehicle.driving.double_track import DoubleTrack
from miho.vehicle.driving.embedded import embedded_plant
from miho.vehicle.driving.plant import Command, Motion
from miho.vehicle.driving.road import PLANE, Road
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.models.magic_formula import MagicFormula
from tests.vehicle.driving.test_vehicle import av21

PERIOD = 0.01
SHIFTS = ("PHX1", "PHX2", "PVX1", "PVX2", "PEX4", "RHX1", "PHY1", "PHY2", "PVY1", "PVY2", "PEY3",
          "RHY1", "RHY2", "RVY1", "RVY2", "RBY3")  # fmt: skip


@cache
def plant() -> DoubleTrack:
    return embedded_plant(Vehicle.from_settings(av21()))


def symmetric(road: Road = PLANE, **changes: float) -> DoubleTrack:
    """A car that is its own mirror image: no inclination, and tires without shifts."""
    true = plant()

    def even(tire: MagicFormula) -> MagicFormula:
        return replace(tire, parameters=replace(tire.parameters, **dict.fromkeys(SHIFTS, 0.0)))

    front, rear = even(true.tires[0]), even(true.tires[2])
    level = {"inclination_front": 0.0, "inclination_rear": 0.0}
    vehicle = replace(true.vehicle, **(level | changes))
    return replace(true, vehicle=vehicle, tires=(front, front, rear, rear), road=road)


def circle(radius: float, bank: float) -> Road:
    """A left-hand circle of constant bank [rad]."""
    n = 720
    heading = np.linspace(0, 2 * np.pi, n + 1)
    step = 2 * np.pi * radius / n
    banks, curvature = np.full(n + 1, bank), np.full(n, 1 / radius)
    x, y = radius * np.sin(heading), radius * (1 - np.cos(heading))
    return Road(step, True, 2 * np.pi, x, y, heading, banks, curvature)


def driven(
    car: DoubleTrack, commands: Iterable[tuple[float, Command]], **start: float
) -> list[Motion]:
    """Motions at the start and after each period of commands that are held for seconds."""
    state = car.start(**start)  # type: ignore[arg-type]
    motions = [car.motion(state)]
    for seconds, command in commands:
        for _ in range(round(seconds / PERIOD)):
            state = car.advance(state, command, PERIOD)
            motions.append(car.motion(state))
    return motions
