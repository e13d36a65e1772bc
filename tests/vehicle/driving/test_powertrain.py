"""Engine, gears, brakes and actuators of the plant against the models they stand for."""

import numpy as np
import pytest

from miho.vehicle.driving.plant import Command
from miho.vehicle.driving.powertrain import braking_torques, engine_of, map_torque
from miho.vehicle.models import BrakeResponse
from tests.vehicle.driving.plants import driven, plant, symmetric


def test_the_engine_map_is_the_same() -> None:
    true = plant().engine
    numbers = engine_of(plant().vehicle, true)
    rng = np.random.default_rng(0)
    for omega, throttle in zip(rng.uniform(50, 800, 200), rng.uniform(0, 1, 200), strict=True):
        expected = float(true.torque(omega, throttle))
        assert map_torque(numbers, omega, throttle) == pytest.approx(expected, abs=1e-10)
    assert map_torque(numbers, 300.0, 1.0) == pytest.approx(float(true.torque(300.0, 1.0)))


def test_the_pressure_is_that_of_the_brake() -> None:
    """Within 1e-6 of the pressure: Runge-Kutta against the exact solution, on the plant's steps."""
    car = plant()
    brake = car.brake
    levels = [(0.3, 3e6), (0.2, 1e6), (0.1, 0.0), (0.4, 5e6)]
    motions = driven(car, [(held, Command(gear=0, brake=p)) for held, p in levels], gear=0)
    t = np.array([motion.time for motion in motions])
    starts = np.cumsum([0.0] + [held for held, _ in levels])
    rows = np.concatenate([[-1.0], starts[:-1]])
    target = np.concatenate([[0.0], [p for _, p in levels]])
    times = np.union1d(rows, t)
    held = target[np.searchsorted(rows, times + 1e-9, side="right") - 1]
    theta = np.array([[brake.delay, brake.tau_rise, brake.tau_fall]])
    expected = BrakeResponse().predict(theta, times, held)[0][np.searchsorted(times, t)]
    pressures = np.array([motion.brake_pressure for motion in motions])
    np.testing.assert_allclose(pressures, expected, atol=5.0)


def test_the_steering_is_late_slow_and_limited() -> None:
    """A small step follows 1 - exp(-(t - delay) / lag); a large one the rate, up to the stop."""
    car = plant()
    v = car.vehicle
    for motion in driven(car, [(0.4, Command(0.01, gear=0))], speed=5.0, gear=0):
        since = max(motion.time - v.steering_delay, 0.0)
        assert motion.steering == pytest.approx(0.01 * (1 - np.exp(-since / v.steering_lag)), 1e-6)
    large = driven(car, [(2.0, Command(1.0, gear=0))], speed=1.0, gear=0)
    assert large[20].steering == pytest.approx(v.steering_rate * 0.16, rel=1e-9)
    assert large[-1].steering == pytest.approx(v.steering_max, rel=1e-6)


def test_the_torque_spools_up() -> None:
    """From closed to full throttle at an engine speed that hardly moves; first-order rise."""
    car = symmetric(spool_rise=0.3, engine_inertia=5.0)
    motions = driven(car, [(1.0, Command(gear=5)), (0.31, Command(throttle=1.0, gear=5))],
                     speed=60.0, gear=5)  # fmt: skip
    before, after = motions[101], motions[-1]
    low = motions[100].engine_torque
    full = float(car.engine.torque(after.engine_speed, 1.0))
    share = 1 - np.exp(-0.31 / 0.3)
    assert after.engine_torque == pytest.approx(low + share * (full - low), rel=0.02)
    assert before.engine_torque < 0


def test_a_shift_takes_the_drive_for_its_time() -> None:
    car = symmetric(shift_time=0.1)
    commands = [(1.0, Command(throttle=0.8, gear=3)), (0.5, Command(throttle=0.8, gear=4))]
    motions = driven(car, commands, speed=40.0, gear=3)
    pulls = [motion.ax > 0 for motion in motions]
    assert pulls[100] and pulls[-1] and not any(pulls[103:110])
    ratio = motions[100].engine_speed / motions[115].engine_speed
    assert ratio == pytest.approx(1.3809 / 1.1154, rel=0.02)


def test_a_shift_that_would_break_the_engine_is_refused() -> None:
    motions = driven(plant(), [(1.0, Command(gear=1))], speed=60.0, gear=5)
    assert {motion.gear for motion in motions} == {5}


def test_the_limiter_and_the_idling_engine() -> None:
    car = plant()
    v = car.vehicle
    fast = driven(car, [(4.0, Command(throttle=1.0, gear=1))], speed=20.0, gear=1)
    assert max(motion.engine_speed for motion in fast) < v.engine_speed_max + 21
    slow = driven(car, [(2.0, Command(throttle=0.6, gear=1))], gear=1)
    assert min(motion.engine_speed for motion in slow) == v.idle_speed
    assert slow[-1].vx > 1, "the slipping clutch pulls away"


def test_a_locked_differential_holds_the_wheels_together() -> None:
    """With all the load on one wheel in a turn the open one lets its speed run away."""
    command = [(2.0, Command(0.02, 1.0, gear=2))]
    spread = []
    for damping in (0.0, 60.0):
        car = symmetric(differential_damping=damping)
        wheels = driven(car, command, speed=25.0, gear=2)[-1].wheel_speeds
        spread.append(abs(wheels[2] - wheels[3]))
    assert spread[1] < spread[0]


def test_the_brakes_are_those_of_the_model() -> None:
    """The torques of both wheels of each axle, without rolling resistance, at their radii."""
    vehicle, brake = plant().vehicle, plant().brake
    front, rear = braking_torques(vehicle, brake, 3e6)
    rolling_front, rolling_rear = braking_torques(vehicle, brake, 0.0)
    total = 2 * (front - rolling_front) / vehicle.wheel_radius_front
    total += 2 * (rear - rolling_rear) / vehicle.wheel_radius
    assert total == pytest.approx(float(brake.force_of_pressure(3e6)), rel=1e-12)
    rolling = rolling_front / vehicle.wheel_radius_front + rolling_rear / vehicle.wheel_radius
    assert 2 * rolling == pytest.approx(vehicle.C_r, rel=1e-12)
