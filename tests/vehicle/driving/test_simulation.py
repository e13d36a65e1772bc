"""The closed loop in short drives; `tests/test_drive.py` has the whole ones."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from experiments.driving.outcome import excess, gap, planned_use, plans, true_use
from miho.vehicle.driving.driver import Driver, Sighting
from miho.vehicle.driving.embedded import embedded_plant
from miho.vehicle.driving.lines import beside, constant
from miho.vehicle.driving.local_plan import LocalPlanner, Obstacle
from miho.vehicle.driving.ovals import ims, lvms
from miho.vehicle.driving.path_tracking import Weights
from miho.vehicle.driving.plant import Motion, Sensors
from miho.vehicle.driving.road import road_of
from miho.vehicle.driving.simulation import Drive, simulate
from miho.vehicle.driving.track import Track
from tests.vehicle.driving.cars import car

WEIGHTS = Weights(steering=100.0)


def driver(line: Track, mu: float, top_speed: float, **more: object) -> Driver:
    embedded = car()
    plan = embedded.planner(mu, top_speed).plan(line)
    speed, steering = embedded.speed_controller(), embedded.steering_controller(WEIGHTS)
    return Driver(plan, speed, steering, **more)  # type: ignore[arg-type]


def driven(
    driver: Driver, road: Track, s: float, e: float, speed: float, distance: float, seed: int | None
) -> Drive:
    plant = embedded_plant(car().vehicle, road_of(road))
    start = plant.start(s, e, speed, driver.speed.start(speed).gear)
    if seed is None:
        return simulate(plant, driver, start, distance)
    rng = np.random.default_rng(seed)
    return simulate(plant, driver, start, distance, sensors=Sensors(), rng=rng)


@cache
def avoidance(seed: int | None = 0, reserve: float = 0.12) -> tuple[Drive, Driver]:
    """IMS, mu = 0.7, 100 km/h, an obstacle on the line that is seen 80 m before."""
    road = ims()
    line, speed = beside(road, constant(-4.5)), 100 / 3.6
    follower = driver(line, 0.7, speed)
    planner = replace(car().planner(0.7, speed), reserve=reserve)
    local = LocalPlanner(out=20.5, back=32.0)
    sighting = Sighting((Obstacle(s=440.0, e=0.0, width=4.0),), 80.0, local, planner)
    follower = replace(follower, sighting=sighting)
    return driven(follower, road, 355.0, -4.5, speed, 120.0, seed), follower


def test_the_car_brakes_and_goes_around_the_obstacle_within_its_limits() -> None:
    """Above 9 m/s^2 and to 10 degrees as in the paper's test, within the planned friction."""
    drive, driver = avoidance()
    assert drive.stopped == ""
    assert drive["v_des"].min() < 55 / 3.6
    assert np.abs(drive["ay"]).max() > 9.0
    assert np.degrees(drive["u_steering"].min()) == pytest.approx(-10.0, abs=1.0)
    assert planned_use(drive, driver).max() < 1.0
    line = driver.plan.line
    for x, y in zip(drive["x"], drive["y"], strict=True):
        at = line.project(float(x), float(y))
        assert at.e < line.at(at.s).width_left - 1.0
        assert -at.e < line.at(at.s).width_right - 1.0
        if abs(at.s - 440.0) < (4.9 + 5.0) / 2:
            assert abs(at.e) > (1.93 + 4.0) / 2 + 0.3
    assert np.abs(drive["e_y"]).max() < 0.3
    assert gap(drive, driver) > 0.3


def test_the_pedals_are_ahead_of_their_lag() -> None:
    """The brakes take 0.17 s: without a lead the car is 1.7 m/s late at 10 m/s^2."""
    drive, _ = avoidance()
    braking = (drive["u_brake"] > 0) & (drive["distance"] < 60.0)
    assert braking.sum() > 100
    late = (drive["vx"] - drive["v_des"])[braking]
    assert np.abs(late).max() < 0.8


def test_without_a_reserve_the_car_exceeds_the_planned_friction() -> None:
    """It overshoots the steady plan; that is counted, and the tires' own limit is far."""
    drive, driver = avoidance(reserve=0.0)
    use = planned_use(drive, driver)
    beyond = excess(drive, use)
    assert beyond is not None
    assert 1.05 < beyond.largest < 1.3
    assert beyond.duration == pytest.approx(0.01 * (use > 1).sum())
    assert true_use(drive, driver).max() < 1.0


def test_the_same_seed_gives_the_same_drive() -> None:
    first, again = avoidance()[0], avoidance.__wrapped__()[0]
    for name, values in first.columns.items():
        np.testing.assert_array_equal(values, again[name], err_msg=name)
    other = avoidance(1)[0]
    assert not np.array_equal(other["x"], first["x"])


def test_a_log_of_the_drive_is_data() -> None:
    drive, _ = avoidance()
    log = drive.log("swerve")
    assert log.dt == pytest.approx(0.01)
    assert np.abs(log["vx"] - drive["vx"]).std() == pytest.approx(0.04, abs=0.02)
    assert len(drive) == len(log)


@pytest.mark.parametrize("lost", [("vx",), ("x", "y", "yaw", "vx", "vy", "yaw_rate", "steering")])
def test_a_car_without_sensors_stands_on_the_road_in_the_end(lost: tuple[str, ...]) -> None:
    """From 40 m/s in the steep turn; with no sensor at all it goes by its models alone."""

    class Failing(Sensors):
        def measure(self, motion: Motion, rng: np.random.Generator) -> Motion:
            missing = dict.fromkeys(lost, math.nan)
            return motion._replace(**missing) if motion.time > 1.0 else motion  # type: ignore[arg-type]

    road = lvms(step=4.0)
    follower = driver(road, 0.7, 40.0)
    plant = embedded_plant(car().vehicle, road_of(road))
    start = plant.start(400.0, 0.0, 40.0, follower.speed.start(40.0).gear)
    rng = np.random.default_rng(0)
    drive = simulate(plant, follower, start, 1000.0, sensors=Failing(), rng=rng)
    assert drive.stopped == f"{lost[0]} is not finite"
    assert drive["vx"][-1] < 0.5
    assert drive["distance"][-1] < 220.0, "40 m at 40 m/s, and 133 m at 6 m/s^2, and lags"
    assert np.abs(drive["e_y"]).max() < road.width_left.min() - 1.0


def test_plans_are_the_same_after_any_number_of_laps() -> None:
    _, driver = avoidance()
    lap = driver.plan.line.length
    here, *laps = (plans(driver, 300.0 + n * lap) for n in (0, -1, 2))
    assert here["least speed of the plan, corrected [km/h]"] == pytest.approx(47.0, abs=1.0)
    assert laps == [here, here]


def test_a_drive_that_the_time_limit_ends_says_so() -> None:
    road = lvms(step=4.0)
    follower = driver(road, 0.7, 30.0)
    plant = embedded_plant(car().vehicle, road_of(road))
    drive = simulate(plant, follower, plant.start(speed=30.0), 1000.0, longest=0.5)
    assert drive.stopped == "at the time limit of 0.5 s, after 15 of 1000 m"


def test_bad_input_is_refused() -> None:
    follower = driver(lvms(step=4.0), 0.7, 30.0)
    plant = embedded_plant(car().vehicle, road_of(follower.plan.line))
    with pytest.raises(ValueError, match="distance is nan"):
        simulate(plant, follower, plant.start(speed=10.0), math.nan)
    with pytest.raises(ValueError, match="rng is None; give a numpy Generator"):
        simulate(plant, follower, plant.start(speed=10.0), 10.0, sensors=Sensors())


def test_from_standstill_the_car_drives_off() -> None:
    road = lvms(step=4.0)
    drive = driven(driver(road, 0.7, 15.0), road, 0.0, 0.0, 0.0, 60.0, None)
    assert drive["vx"][-1] > 10.0
    assert np.abs(drive["e_y"]).max() < 0.3
