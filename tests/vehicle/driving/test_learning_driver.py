"""A road whose friction changes, and a driver that follows it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from experiments.driving.falling_grip import MEAN, FrontAxle
from miho.vehicle.driving.double_track import FrictionSchedule
from miho.vehicle.driving.driver import Driver
from miho.vehicle.driving.embedded import embedded_plant
from miho.vehicle.driving.learning_driver import FrictionSource, LearningDriver, slowed_from
from miho.vehicle.driving.ovals import lvms
from miho.vehicle.driving.path_tracking import Weights
from miho.vehicle.driving.plant import Motion
from miho.vehicle.driving.road import road_of
from miho.vehicle.driving.simulation import simulate
from miho.vehicle.driving.track import Track
from tests.vehicle.driving.cars import car


class Known(FrictionSource):
    """A constant friction."""

    def friction(self, motion: Motion, curvature: float, bank: float) -> float:
        """See `FrictionSource.friction`."""
        return 0.7


def test_a_fall_is_linear_between_its_ends() -> None:
    """Constant before and after, half of the fall in the middle."""
    schedule = FrictionSchedule.drop(at=10.0, share=0.4, within=0.2)
    assert schedule.at(0.0) == 1.0
    assert math.isclose(schedule.at(10.1), 0.8)
    assert schedule.at(11.0) == 0.6


@pytest.mark.parametrize(
    ("time", "friction", "message"),
    [
        ((), (), "friction has 0 values for 0 times"),
        ((1.0, 1.0), (1.0, 0.5), "expected finite times that rise"),
        ((1.0,), (0.0,), "expected numbers above 0"),
    ],
)
def test_a_bad_schedule_is_refused(
    time: tuple[float, ...], friction: tuple[float, ...], message: str
) -> None:
    """One sentence with the value."""
    with pytest.raises(ValueError, match=message):
        FrictionSchedule(time, friction)


def test_a_plan_from_too_high_a_speed_falls_to_the_plan() -> None:
    """It begins at the car's speed, never rises before it meets the plan, and equals it then."""
    line = lvms(step=5.0, flat=True)
    planner = car().planner(0.5, 70.0)
    plan = planner.plan(line)
    fast = slowed_from(plan, plan.friction, 500.0, 65.0, 10.0)
    start = int(500.0 / line.step)
    above = np.flatnonzero(fast.v > plan.v)
    assert fast.v[start] == 65.0
    assert above[0] == start
    assert (np.diff(fast.v[above]) < 0).all()
    assert slowed_from(plan, plan.friction, 500.0, 1.0, 10.0) is plan


def test_without_a_limit_of_the_brakes_the_tires_slow_the_car() -> None:
    """A planner without a brake has no largest deceleration; the tires end far below 50 m/s^2."""
    plan = car().planner(0.5, 70.0).plan(lvms(step=5.0, flat=True))
    unlimited, limited = (
        slowed_from(plan, plan.friction, 500.0, 65.0, most) for most in (math.inf, 50.0)
    )
    np.testing.assert_allclose(unlimited.v, limited.v, atol=1e-6)


def test_drag_helps_the_brakes_to_slow_the_car() -> None:
    """On the straight the deceleration is the one of the brakes plus drag / mass."""
    line = lvms(step=5.0, flat=True)
    plan = car().planner(0.5, 70.0).plan(line)
    fast = slowed_from(plan, plan.friction._replace(mu=1.0), 0.0, 75.0, 4.0)
    drag = car().vehicle.C_d * 75.0**2 / car().vehicle.mass
    assert drag > 1.0
    assert fast.ax[0] == pytest.approx(-(4.0 + drag), rel=1e-6)


class ShownByTheTurn(FrictionSource):
    """A friction of 1, and 0.7 from a place in the second turn on."""

    def __init__(self, line: Track) -> None:
        self.line = line

    def friction(self, motion: Motion, curvature: float, bank: float) -> float:
        """See `FrictionSource.friction`."""
        return 0.7 if self.line.project(motion.x, motion.y).s > 1640.0 else 1.0


@pytest.mark.parametrize(("reserve", "finished"), [(0.0, False), (0.2, True)])
def test_a_reserve_at_the_entry_saves_a_car_whose_turn_shows_the_fall(
    reserve: float, finished: bool
) -> None:
    """The grip is 30 % less before the turn, and the driver knows it 0.4 s after turning in."""
    line = lvms(step=5.0, flat=True)
    known = car()
    planner = replace(known.planner(0.7, 80.0), entry_reserve=reserve)
    plan = planner.plan(line)
    driver = Driver(
        plan, known.speed_controller(), known.steering_controller(Weights(steering=100.0))
    )
    low = FrictionSchedule((0.0,), (0.7,))
    true = replace(embedded_plant(known.vehicle, road_of(line)), friction=low)
    speed, _ = plan.at(1560.0)
    start = true.start(1560.0, 0.0, speed, known.speed_controller().start(speed).gear)
    learning = LearningDriver(driver, planner, ShownByTheTurn(line))
    drive = simulate(true, learning, start, 300.0, longest=12.0)
    assert (not drive.stopped) == finished
    if finished:
        assert drive["time"][-1] < 8.0, "a car that crawls does not finish"
        assert np.abs(drive["e_y"]).max() < 1.0


def test_the_driver_plans_and_steers_with_the_friction_of_the_source() -> None:
    """After the first command the plan is the one for 0.7 of the grip."""
    line = lvms(step=5.0, flat=True)
    known = car()
    planner = known.planner(0.8, 60.0)
    driver = Driver(
        planner.plan(line), known.speed_controller(), known.steering_controller(Weights())
    )
    learning = LearningDriver(driver, planner, Known())
    motion = Motion(*np.zeros(len(Motion._fields)))._replace(vx=20.0, yaw=float(line.heading[0]))
    _, state = learning.step(learning.begin(motion), motion)
    assert math.isclose(state.plan.friction.mu, 0.8 * 0.7)
    expected = known.planner(0.8 * 0.7, 60.0).plan(line)
    np.testing.assert_allclose(state.plan.v, expected.v)


def test_less_friction_needs_more_slip_and_keeps_the_stiffness() -> None:
    """The similarity method: F(a; mu) = mu F(a / mu), about the centre of the curve."""
    front = car().steering_controller(Weights()).front
    force, load = 0.4 * float(front.force.max()), front.load
    full = front.at(force, load) - front.centre
    less = front.at(0.7 * force, load, 0.7) - front.centre
    assert math.isclose(less, 0.7 * full, rel_tol=1e-9)


def test_a_row_of_the_front_axle_is_a_mean_and_unknown_while_braking() -> None:
    """A straight roll has no force; braking makes the force unknown."""
    axle = FrontAxle(car().vehicle)
    motion = Motion(*np.zeros(len(Motion._fields)))._replace(vx=30.0, time=1.0)
    rows = [axle.row(motion, 0.0, 0.0) for _ in range(MEAN)]
    assert rows[:-1] == [None] * (MEAN - 1)
    assert rows[-1] is not None
    assert rows[-1]["slip"] == rows[-1]["use"] == 0.0
    assert rows[-1]["load"] > 1.0  # downforce
    for _ in range(MEAN):
        braking = axle.row(motion._replace(brake_pressure=1e6), 0.0, 0.0)
    assert braking is not None
    assert math.isnan(braking["use"])
