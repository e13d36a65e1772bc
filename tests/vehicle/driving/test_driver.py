"""The driver: pace, re-planning, and safe stops."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from miho.vehicle.driving.as_printed import PrintedPlanner
from miho.vehicle.driving.driver import Driver, Pace, Sighting, SlowZone
from miho.vehicle.driving.embedded import embedded_plant
from miho.vehicle.driving.local_plan import LocalPlanner, Obstacle
from miho.vehicle.driving.ovals import lvms
from miho.vehicle.driving.path_tracking import Weights
from miho.vehicle.driving.plant import Motion
from miho.vehicle.driving.road import road_of
from tests.vehicle.driving.cars import car

LINE = lvms(step=4.0)
PLANNER = car().planner(0.7, 40.0)


@cache
def planned() -> Driver:
    """A driver of the whole line; its plan is what is compiled first."""
    steering = car().steering_controller(Weights(steering=100.0))
    return Driver(PLANNER.plan(LINE), car().speed_controller(), steering)


def motion(s: float = 50.0, speed: float = 30.0) -> Motion:
    plant = embedded_plant(car().vehicle, road_of(LINE))
    return plant.motion(plant.start(s, 0.0, speed, planned().speed.start(30.0).gear))


@pytest.mark.parametrize("name", ["x", "yaw", "vx", "yaw_rate", "steering"])
def test_a_sensor_that_fails_makes_a_safe_stop_for_good(name: str) -> None:
    here = motion()
    driver = planned()
    before, state = driver.step(driver.begin(here), here)
    command, state = driver.step(state, here._replace(**{name: math.nan}))
    assert state.stopped == f"{name} is not finite"
    assert command.steering == pytest.approx(before.steering, abs=0.01), "it goes on turning"
    assert command.throttle == 0
    force = float(car().brake.force_of_pressure(command.brake))
    assert force == pytest.approx(6.0 * car().vehicle.mass, rel=1e-6)
    command, state = driver.step(state, here)
    assert state.stopped
    assert command.brake > 0, "it comes back, but is not trusted"


def test_printed_speeds_are_planned_from_each_motion() -> None:
    """A car that yaws faster has less left by Eq. 11; without its lateral acceleration it stops."""
    s = LINE.length / 2 - 400.0  # in the steep turn
    curvature, here = float(LINE.at(s).curvature), motion(s, 50.0)
    live = PrintedPlanner(car().vehicle, car().grip, 0.7, 80.0)
    driver = replace(planned(), plan=live.plan(LINE), live=live)
    state, desired = driver.begin(here), []
    for yaw_rate in (0.1, 0.15):
        turning = here._replace(yaw_rate=yaw_rate, ay=50.0 * yaw_rate)
        _, state = driver.step(state, turning)
        bank = float(LINE.at(state.at).bank)
        assert state.desired == live.speed(turning, curvature, bank)
        desired.append(state.desired)
    assert desired[0] ** 2 - desired[1] ** 2 == pytest.approx(50 * 0.05 / curvature, rel=1e-6)
    _, state = driver.step(state, here._replace(ay=math.nan))
    assert state.stopped == "ay is not finite"
    _, state = planned().step(planned().begin(here), here._replace(ay=math.nan))
    assert not state.stopped


def test_a_car_far_from_its_line_stops() -> None:
    here = motion()
    x, y = map(float, LINE.position(50.0, 11.0))
    driver = planned()
    command, state = driver.step(driver.begin(here), here._replace(x=x, y=y))
    assert state.stopped == "11.0 m off the line"
    assert command.throttle == 0
    assert command.brake > 0


def test_the_pace_moves_by_its_ramp_and_counts_laps() -> None:
    driver = replace(planned(), pace=Pace((32.0, 36.0), ramp=2.0))
    state = driver.begin(motion())
    for _ in range(50):
        _, state = driver.step(state, motion())
    assert state.desired == pytest.approx(31.0), "half a second of 2 m/s^2 from 30 m/s"
    for _ in range(100):
        _, state = driver.step(state, motion())
    assert (state.desired, state.laps) == (pytest.approx(32.0), 0)
    for s in (LINE.length - 3.0, 3.0):
        for _ in range(300):
            _, state = driver.step(state, motion(s))
    assert (state.desired, state.laps) == (pytest.approx(36.0), 1)


def test_the_pace_slows_down_in_a_zone_on_the_brakes() -> None:
    """At its own rate, in the second lap alone, as the zone's distance has it."""
    zone = SlowZone(LINE.length + 40.0, LINE.length + 60.0, 20.0)
    pace = Pace((30.0,), ramp=2.0, brake_ramp=5.0, slow=(zone,))
    driver = replace(planned(), pace=pace)
    state = driver.begin(motion())
    _, state = driver.step(state, motion())
    assert state.desired == pytest.approx(30.0), "the first lap"
    state = state._replace(laps=1)
    for _ in range(100):
        command, state = driver.step(state, motion())
    assert state.desired == pytest.approx(25.0), "a second of 5 m/s^2"
    assert command.brake > 0
    assert command.throttle == 0
    for _ in range(100):
        _, state = driver.step(state, motion(70.0))
    assert state.desired == pytest.approx(27.0), "a second of 2 m/s^2 beyond it"


def test_an_obstacle_is_planned_around_once_it_is_seen() -> None:
    obstacle = Obstacle(s=160.0, e=0.0)
    driver = replace(planned(), sighting=Sighting((obstacle,), 80.0, LocalPlanner(), PLANNER))
    state = driver.begin(motion(70.0))
    _, state = driver.step(state, motion(70.0))
    assert state.plan is driver.plan, "90 m away"
    state = driver.begin(motion(85.0))
    _, state = driver.step(state, motion(85.0))
    assert state.planned
    x, y = state.plan.line.position(state.at + 75.0)
    away = abs(LINE.project(float(x), float(y)).e)
    assert away > (1.93 + 2.0) / 2 + 0.7 - 1e-6
    again, _ = driver.step(state, motion(86.0))
    assert np.isfinite(again).all()


@pytest.mark.parametrize(
    ("obstacle", "speed", "reason"),
    [
        (Obstacle(s=160.0, e=0.0, width=14.0), 30.0, "no path with"),
        (Obstacle(s=115.0, e=0.0), 39.0, "too fast for the path around it"),
    ],
)
def test_an_obstacle_with_no_way_around_makes_a_safe_stop(
    obstacle: Obstacle, speed: float, reason: str
) -> None:
    sighting = Sighting((obstacle,), 80.0, LocalPlanner(), PLANNER)
    driver = replace(planned(), sighting=sighting)
    here = motion(85.0, speed)
    command, state = driver.step(driver.begin(here), here)
    assert reason in state.stopped
    assert command.brake > 0


def test_a_bad_pace_is_refused() -> None:
    with pytest.raises(ValueError, match=r"top_speeds is .* expected speeds above 0 m/s"):
        Pace(())
    with pytest.raises(ValueError, match="ramp is 0"):
        Pace((30.0,), ramp=0)
    with pytest.raises(ValueError, match="brake_ramp is 0"):
        Pace((30.0,), brake_ramp=0)
    with pytest.raises(ValueError, match=r"slow zone is \(60.0, 40.0, 20.0\); expected a start"):
        Pace((30.0,), slow=(SlowZone(60.0, 40.0, 20.0),))
