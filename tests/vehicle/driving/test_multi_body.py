"""The second plant behind the interface of the first; skipped where its package is absent."""

from importlib import import_module

import numpy as np
import pytest

from miho.vehicle.driving.load_transfer import LoadTransfer
from miho.vehicle.driving.plant import Command
from tests.vehicle.driving.multi_body import MultiBody
from tests.vehicle.driving.plants import circle, plant

pytest.importorskip("vehiclemodels")


@pytest.fixture(scope="module")
def car() -> MultiBody:
    true = plant()
    return MultiBody(true.vehicle, true.engine, true.brake)


def test_a_gentle_turn_is_that_of_a_neutral_car(car: MultiBody) -> None:
    """Both axles' stiffness is proportional to their load, so kappa = delta / L.

    Within 5 %: camber and compliance of its axles add some understeer at 1.2 m/s^2.
    """
    vehicle = car.own_vehicle
    front, rear = (axle.cornering_stiffness for axle in car.axles)
    assert front * vehicle.lf == pytest.approx(rear * vehicle.lr)
    state = car.advance(car.start(speed=20.0, gear=0), Command(0.008, gear=0), 1.5)
    motion = car.motion(state)
    assert motion.steering == pytest.approx(0.008, rel=1e-6)
    expected = motion.vx * 0.008 / vehicle.wheelbase
    assert motion.yaw_rate == pytest.approx(expected, rel=0.05)
    assert motion.ay == pytest.approx(motion.vx * motion.yaw_rate, rel=0.05)


def test_a_left_turn_loads_the_right_wheels(car: MultiBody) -> None:
    state = car.advance(car.start(speed=20.0, gear=0), Command(0.03, gear=0), 1.0)
    motion = car.motion(state)
    fl, fr, rl, rr = motion.loads
    assert motion.y > 0 and fr > 2 * fl and rr > 2 * rl
    assert motion.loads.sum() == pytest.approx(9.81 * car.own_vehicle.mass, rel=0.01)
    assert motion.wheel_speeds[1] > motion.wheel_speeds[0], "the outer wheel turns faster"


def test_its_axles_are_its_own_tires(car: MultiBody) -> None:
    """At rest and without camber, by the library's own function."""
    formula = import_module("vehiclemodels.utils.tire_model").formula_lateral
    loads = LoadTransfer(car.own_vehicle).wheel_loads(0.0, gravity=9.81)
    for axle, load in zip(car.axles, (loads.front_left, loads.rear_left), strict=True):
        for alpha in (-0.2, -0.05, 0.01, 0.1):
            expected = 2 * formula(alpha, 0.0, float(load), car.parameters.tire)[0]
            assert float(axle.force(alpha)) == pytest.approx(expected, rel=1e-9)


def test_the_gears_add_to_the_braking_of_the_engine(car: MultiBody) -> None:
    """With closed throttle, power flows from the wheels to the engine: within 10 %."""
    v = car.own_vehicle
    coasting = car.motion(car.advance(car.start(speed=20.0, gear=1), Command(gear=1), 0.5))
    torque = float(car.engine.torque(coasting.engine_speed, 0.0))
    lever = v.gear_ratios[0] * v.final_drive / v.wheel_radius
    force = torque * lever / v.efficiency - v.C_r - v.C_d * coasting.vx**2
    mass = v.mass + float(v.longitudinal.equivalent_mass(1))
    assert coasting.ax == pytest.approx(force / mass, rel=0.1)


def test_commands_act_on_its_mass(car: MultiBody) -> None:
    """As its longitudinal model says at that speed, within 10 %: its wheels are heavier."""
    v = car.own_vehicle
    start = car.start(speed=25.0, gear=3)
    motion = car.motion(car.advance(start, Command(throttle=0.5, gear=3), 0.5))
    torque = float(car.engine.torque(motion.engine_speed, 0.5))
    expected = float(v.longitudinal.acceleration(torque, motion.vx, 3))
    assert motion.ax == pytest.approx(expected, rel=0.1)
    braked = car.motion(car.advance(car.start(speed=25.0, gear=0), Command(brake=1e6, gear=0), 0.5))
    slowed = float(car.brake.force_of_pressure(1e6)) + v.C_r + v.C_d * braked.vx**2
    assert braked.ax == pytest.approx(-slowed / v.mass, rel=0.1)


def test_it_starts_on_the_road_and_keeps_its_states() -> None:
    true = plant()
    car = MultiBody(true.vehicle, true.engine, true.brake, road=circle(100.0, 0.0))
    state = car.start(s=50 * np.pi, offset=2.0, speed=10.0)
    before = car.motion(state)
    assert (before.x, before.y, before.yaw) == pytest.approx((98.0, 100.0, np.pi / 2), abs=1e-3)
    first, again = (car.motion(car.advance(state, Command(0.1), 0.05)) for _ in range(2))
    np.testing.assert_array_equal(np.hstack(first), np.hstack(again))
    np.testing.assert_array_equal(np.hstack(car.motion(state)), np.hstack(before))
