"""What a drive came to: errors, limits, clearance, and what the printed equations would plan."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.constants import g

from miho.driving.driver import Driver
from miho.driving.embedded import embedded_tires
from miho.driving.friction import friction_car, measured_use
from miho.driving.grip import Grip
from miho.driving.known_car import inclinations, static_loads
from miho.driving.simulation import Drive
from miho.driving.track import Track
from miho.driving.velocity_as_printed import PrintedPlanner
from miho.driving.velocity_planner import front_share

CAR_LENGTH, CAR_WIDTH = 4.9, 1.93
"""Of the AV-21 [m]."""
EVERY = 5
"""Of the rows of a drive every fifth, at 100 Hz some 3 m apart, is looked up on the road."""


class Clearance(NamedTuple):
    """Distances [m] of the car's sides from the left and the right edge of the road, negative
    beyond it, with the rows of the drive they belong to; (k,) each."""

    rows: np.ndarray
    left: np.ndarray
    right: np.ndarray

    @classmethod
    def of(cls, drive: Drive, road: Track) -> Clearance:
        """The clearance of a car along a drive; the road is that of the plant."""
        rows = np.arange(0, len(drive), EVERY)
        edges, hint = np.empty((2, rows.size)), None
        for i, (x, y) in enumerate(zip(drive["x"][rows], drive["y"][rows], strict=True)):
            at = road.project(float(x), float(y), hint)
            hint = at.s
            point = road.at(at.s)
            edges[:, i] = float(point.width_left) - at.e, float(point.width_right) + at.e
        left, right = edges - CAR_WIDTH / 2
        return cls(rows, left, right)

    @property
    def least(self) -> np.ndarray:
        """Distance to the nearer edge [m], (k,)."""
        return np.asarray(np.minimum(self.left, self.right))


class Departure(NamedTuple):
    """How a car left its road: when [s] and after how many metres a side of it first crossed an
    edge, on which side of the road, and how far beyond the edge it came [m]."""

    time: float
    distance: float
    side: str
    beyond: float

    def __str__(self) -> str:
        return (
            f"on the {self.side}, after {self.distance:.0f} m and {self.time:.1f} s, by up to "
            f"{self.beyond:.1f} m"
        )


def departure(drive: Drive, clearance: Clearance) -> Departure | None:
    """How the car left the road; None if it did not."""
    outside = np.flatnonzero(clearance.least < 0)
    if not outside.size:
        return None
    first = outside[0]
    row = clearance.rows[first]
    return Departure(
        float(drive["time"][row] - drive["time"][0]),
        float(drive["distance"][row]),
        "left" if clearance.left[first] < clearance.right[first] else "right",
        -float(clearance.least.min()),
    )


def outcome_table(
    drive: Drive, driver: Driver, clearance: Clearance, road_friction: float = 1.0
) -> dict[str, float | str]:
    """Largest errors and uses of a drive on a road of this friction."""
    e_psi = float(np.degrees(np.abs(drive["e_psi"]).max()))
    error = drive["vx"] - drive["v_des"]
    within = np.abs(drive["ay"]) / drive["ay_limit"]
    table: dict[str, float | str] = {
        "stopped": drive.stopped or "no",
        "left the road": str(departure(drive, clearance) or "no"),
        "time [s]": _round(drive["time"][-1]),
        "top speed [km/h]": _round(3.6 * drive["vx"].max()),
        "largest position error [m]": _round(np.abs(drive["e_y"]).max()),
        "largest heading error [deg]": _round(e_psi),
        "velocity error, RMS [m/s]": _round(math.sqrt(float(np.mean(error**2)))),
        "velocity error, largest [m/s]": _round(np.abs(error).max()),
        "largest lateral acceleration [m/s^2]": _round(np.abs(drive["ay"]).max()),
        "largest share of the planned lateral limit": _round(within.max()),
        "largest use of the true tires' friction": _round(
            true_use(drive, driver, road_friction).max()
        ),
        "least room to an edge of the road [m]": _round(clearance.least.min()),
    }
    if driver.sighting is not None:
        table["least gap to the obstacle [m]"] = _round(gap(drive, driver))
    return table


def true_use(drive: Drive, driver: Driver, road_friction: float = 1.0) -> np.ndarray:
    """Use of the true tires' friction in steady terms, (N,); above 1 an axle would slide."""
    vehicle = driver.speed.vehicle
    grip = Grip.of_tires(embedded_tires(), static_loads(vehicle), inclinations(vehicle))
    car = friction_car(vehicle, grip, road_friction, front_share(driver.speed.brake))
    turning = drive["vx"] ** 2 * drive["curvature"]
    gravity = g * np.cos(drive["bank"]) + turning * np.sin(drive["bank"])
    return np.asarray(measured_use(car, drive["vx"], drive["ax"], drive["ay"], gravity))


def gap(drive: Drive, driver: Driver) -> float:
    """Least distance [m] between the boxes of car and obstacle, negative in a collision.

    The car is taken to lie along the line that it would drive without the obstacle.
    """
    if driver.sighting is None:
        raise ValueError("the driver has no obstacle; expected a sighting")
    obstacle, line = driver.sighting.obstacles[0], driver.plan.line
    least, hint = math.inf, None
    for x, y in zip(drive["x"], drive["y"], strict=True):
        at = line.project(float(x), float(y), hint)
        hint = at.s
        ahead = abs(math.remainder(at.s - obstacle.s, line.length))
        beside = abs(at.e - obstacle.e) - (CAR_WIDTH + obstacle.width) / 2
        along = ahead - (CAR_LENGTH + obstacle.length) / 2
        least = min(least, max(beside, along))
    return least


def plans(driver: Driver, start: float) -> dict[str, float | str]:
    """The least speeds [km/h] that the planners give on the path around the obstacle.

    start: arc length [m] at which the drive begins. The avoidance is planned without a top speed,
    at the point at which the obstacle is seen, so that the tires alone are the limit.
    """
    sighting = driver.sighting
    if sighting is None:
        raise ValueError("the driver has no obstacle; expected a sighting")
    line = driver.plan.line
    sighted = max(start, sighting.obstacles[0].s - sighting.distance)
    path = sighting.local.path(line, sighting.obstacles, sighted)
    near = (path.s > sighted) & (path.s < sighting.obstacles[0].s + sighting.distance)
    planner = replace(sighting.velocity, top_speed=90.0)
    slowest = {"corrected": planner.lateral_limits(path)[near].min()}
    for name, transfer, yaw in (
        ("as printed", False, True),
        ("as printed, Eq. 11 without yaw term", False, False),
        ("the same with load transfer by a_y", True, False),
    ):
        printed = PrintedPlanner(
            planner.vehicle, planner.grip, planner.mu, transfer=transfer, yaw_term=yaw
        )
        slowest[name] = printed.speeds(path)[near].min()
    ratio = slowest["as printed"] / slowest["as printed, Eq. 11 without yaw term"]
    moved = slowest["the same with load transfer by a_y"]
    cancels = moved / slowest["as printed, Eq. 11 without yaw term"] - 1
    table: dict[str, float | str] = {
        f"least speed of the plan, {name} [km/h]": _round(3.6 * v) for name, v in slowest.items()
    }
    table["printed Eq. 11 over the same without yaw term"] = _round(ratio)
    table["effect of load transfer in Eq. 10 [%]"] = _round(100 * cancels)
    return table


def _round(value: float) -> float:
    """Four digits."""
    return float(f"{float(value):.4g}")
