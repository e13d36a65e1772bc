"""The double track against closed forms, against other code, and against bad input."""

from dataclasses import replace
from math import atan, cos, sin, sqrt, tan

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.constants import g

from miho.vehicle.driving.double_track import DoubleTrack
from miho.vehicle.driving.dynamics import CHI, DELTA, VY, R
from miho.vehicle.driving.load_transfer import LoadTransfer
from miho.vehicle.driving.plant import Command, Motion
from miho.vehicle.driving.vehicle import Vehicle
from tests.vehicle.driving.plants import circle, driven, plant, symmetric

NEUTRAL = Command(gear=0)


def rolling_mass(car: Vehicle) -> float:
    """Mass with what the four rolling wheels add in neutral [kg]."""
    turning = 1 / car.wheel_radius_front**2 + 1 / car.wheel_radius**2
    return car.mass + car.wheel_inertia / 2 * turning


def test_coasting_down_in_neutral() -> None:
    """M v' = -C_d v^2 - C_r has v = k tan(atan(v0 / k) - t sqrt(C_d C_r) / M), k^2 = C_r / C_d.

    The wheels' slip, some 1e-4 of the speed, is left out of that form.
    """
    car = symmetric()
    vehicle = car.vehicle
    k = sqrt(vehicle.C_r / vehicle.C_d)
    rate = sqrt(vehicle.C_r * vehicle.C_d) / rolling_mass(vehicle)
    for motion in driven(car, [(10.0, NEUTRAL)], speed=60.0, gear=0)[::250]:
        expected = k * tan(atan(60 / k) - motion.time * rate)
        assert motion.vx == pytest.approx(expected, rel=1e-4)
        assert motion.vy == motion.y == 0


def test_braking_distance() -> None:
    """M v' = -F - C_d v^2 covers M / (2 C_d) ln((F + C_d v0^2) / (F + C_d v1^2)).

    F is the steady force of `Brake` at the pressure, with the rolling resistance. Within 0.5 %:
    the braked wheels turn slower than they roll, which the form leaves out.
    """
    car = symmetric()
    motions = driven(car, [(4.5, Command(gear=0, brake=3e6))], speed=75.0, gear=0)
    first, last = motions[100], motions[400]
    force = float(car.brake.force_of_pressure(3e6)) + car.vehicle.C_r
    drag, mass = car.vehicle.C_d, rolling_mass(car.vehicle)
    energy = (force + drag * first.vx**2) / (force + drag * last.vx**2)
    assert last.x - first.x == pytest.approx(mass / (2 * drag) * np.log(energy), rel=5e-3)
    assert last.vx < 0.65 * first.vx


def test_full_throttle_is_the_longitudinal_model() -> None:
    """Within 1 % once the torque has settled: slip costs speed and turns the wheels faster."""
    car = symmetric()
    motion = driven(car, [(3.0, Command(throttle=0.6, gear=4))], speed=45.0, gear=4)[-1]
    model = car.vehicle.longitudinal
    rear = motion.wheel_speeds[2] * car.vehicle.wheel_radius
    assert motion.engine_speed == pytest.approx(float(model.engine_speed(rear, 4)), rel=1e-9)
    expected = model.acceleration(motion.engine_torque, motion.vx, 4)
    assert motion.ax == pytest.approx(float(expected), rel=1e-2)
    assert motion.ax > 1


def steady_circle(car: DoubleTrack, steering: float, speed: float, gear: int) -> Motion:
    """The motion after six seconds with the speed held by the throttle."""
    state = car.start(speed=speed, gear=gear)
    for _ in range(600):
        missing = speed - car.motion(state).vx
        throttle = float(np.clip(0.2 + 0.5 * missing, 0, 1))
        state = car.advance(state, Command(steering, throttle, 0.0, gear), 0.01)
    return car.motion(state)


def test_understeer_gradient() -> None:
    """delta = L kappa + K a_y with K = m / L (l_r / C_f - l_f / C_r) (Rajamani, Sec. 3.3).

    The stiffness of an axle is that of its two tires at the loads of that speed. Within 5 %: the
    tires are not linear, and their driving force and drag are left out of the form.
    """
    car = symmetric(differential_damping=0.0)
    v, speed = car.vehicle, 20.0
    motion = steady_circle(car, 0.012, speed, 3)
    loads = LoadTransfer(v).wheel_loads(speed)
    stiffness = []
    for tire, load in ((car.tires[0], loads.front_left), (car.tires[2], loads.rear_left)):
        low, high = (float(tire.forces(load, 0.0, alpha).Fy) for alpha in (-1e-5, 1e-5))
        stiffness.append(2 * (low - high) / 2e-5)
    K = v.mass / v.wheelbase * (v.lr / stiffness[0] - v.lf / stiffness[1])
    curvature = motion.yaw_rate / np.hypot(motion.vx, motion.vy)
    gradient = (motion.steering - v.wheelbase * curvature) / motion.ay
    assert gradient == pytest.approx(K, rel=0.05)
    assert K > 0, "the car understeers"


@pytest.mark.parametrize("steering", [0.02, -0.018])
def test_a_steady_circle_balances(steering: float) -> None:
    """Forces of `MagicFormula` at the slips of the motion hold the car on the circle.

    Everything is computed again from the motion with other code: loads, slips, forces and the
    balances of the lateral forces and of the moment, within 0.5 % of the front axle's share (the
    throttle still moves a little).
    """
    car = plant()
    v = car.vehicle
    motion = steady_circle(car, steering, 45.0, 4)
    assert abs(motion.ay) > 10
    assert motion.ay == pytest.approx(motion.vx * motion.yaw_rate, rel=2e-3)
    loads = LoadTransfer(v).wheel_loads(motion.vx, motion.ax, motion.ay)
    lateral = moment = 0.0
    for i, (tire, load) in enumerate(zip(car.tires, loads, strict=True)):
        px = v.lf if i < 2 else -v.lr
        py = (1, -1)[i % 2] * (v.track_front if i < 2 else v.track_rear) / 2
        delta = motion.steering if i < 2 else 0.0
        radius = v.wheel_radius_front if i < 2 else v.wheel_radius
        vx, vy = motion.vx - motion.yaw_rate * py, motion.vy + motion.yaw_rate * px
        along, across = vx * cos(delta) + vy * sin(delta), vy * cos(delta) - vx * sin(delta)
        gamma = v.inclination_front if i < 2 else v.inclination_rear
        kappa = motion.wheel_speeds[i] * radius / along - 1
        force = tire.forces(load, kappa, np.arctan2(across, along), gamma)
        fx = float(force.Fx) * cos(delta) - float(force.Fy) * sin(delta)
        fy = float(force.Fx) * sin(delta) + float(force.Fy) * cos(delta)
        lateral += fy
        moment += px * fy - py * fx
    whole = v.mass * abs(motion.ay)
    assert lateral == pytest.approx(v.mass * motion.ay, abs=5e-3 * whole)
    assert moment == pytest.approx(0.0, abs=5e-3 * whole * v.lf * v.lr / v.wheelbase)


def test_a_bank_carries_the_car_round() -> None:
    """At v^2 = g R tan(bank) weight alone bends the path, and the tires have no lateral force.

    The car starts as it rolls round: wheels along the circle, atan(L kappa cos(bank)), and no slip
    at the rear axle. The loads add up to m g / cos(bank) and the downforce. Of the 0.30 g that
    weight pulls sideways less than 0.01 g is left to the tires.
    """
    radius, bank = 250.0, 0.3
    car = symmetric(circle(radius, bank), C_d=0.0, C_r=0.0, differential_damping=0.0)
    speed, v = sqrt(g * radius * tan(bank)), car.vehicle
    straight = car.start(speed=speed, gear=0)
    y, turned = straight.y.copy(), atan(v.wheelbase * cos(bank) / radius)
    y[DELTA], y[VY], y[CHI] = turned, v.lr * y[R], -v.lr * cos(bank) / radius
    state = replace(straight, y=y, steering=np.full_like(straight.steering, turned))
    for _ in range(600):
        state = car.advance(state, Command(turned, gear=0), 0.01)
        assert abs(car.motion(state).ay) < 0.01 * g
    last = car.motion(state)
    assert np.hypot(last.x, last.y - radius) == pytest.approx(radius, abs=0.2)
    assert last.yaw == pytest.approx(6 * speed / radius + y[CHI], rel=5e-3)
    downforce = (v.C_l_front + v.C_l_rear) * speed**2
    assert last.loads.sum() == pytest.approx(v.mass * g / cos(bank) + downforce, rel=1e-3)


def test_a_bank_pulls_a_slow_car_down() -> None:
    """At rest the accelerometer feels what keeps the car from sliding, g sin(bank)."""
    motion = driven(
        symmetric(circle(250.0, 0.3)), [(3.0, Command(gear=0, brake=3e6))], gear=0
    )[-1]  # fmt: skip
    assert motion.ay == pytest.approx(-g * sin(0.3), rel=1e-3)
    left, right = motion.loads[0] + motion.loads[2], motion.loads[1] + motion.loads[3]
    assert left > 1.1 * right, "the left side is the lower"
    weight = plant().vehicle.mass * g
    assert motion.loads.sum() == pytest.approx(weight * cos(0.3), rel=1e-6)
    assert np.hypot(motion.vx, motion.vy) < 1e-3


def test_energy_only_leaves_a_rolling_car() -> None:
    """Without resistance a straight run keeps its energy; sliding tires only take of it."""
    car = symmetric(C_d=0.0, C_r=0.0)
    straight = driven(car, [(2.0, NEUTRAL)], speed=50.0, gear=0)
    assert energy(car, straight[-1]) == pytest.approx(energy(car, straight[0]), rel=1e-9)
    weave = [(0.5, Command(steering, gear=0)) for steering in (0.04, -0.04, 0.08, -0.1, 0.0)]
    energies = np.array([energy(car, motion) for motion in driven(car, weave, speed=50.0, gear=0)])
    # What relaxing tires hold for a moment comes back: a spring of 1e5 N over some centimetres.
    assert np.diff(energies).max() < 50.0
    assert energies[-1] < 0.98 * energies[0]


def energy(car: DoubleTrack, motion: Motion) -> float:
    """Of the motion of body and wheels [J]."""
    v = car.vehicle
    body = v.mass * (motion.vx**2 + motion.vy**2) + v.Izz * motion.yaw_rate**2
    return float(body + v.wheel_inertia / 4 * (motion.wheel_speeds**2).sum()) / 2


MANOEUVRE = [
    (1.0, Command(throttle=1.0, gear=4)),
    (1.0, Command(0.02, 0.5, gear=4)),
    (1.0, Command(-0.03, 0.5, gear=5)),
    (0.5, Command(0.02, 0.0, 2e6, gear=5)),
    (1.5, Command(0.0, 0.0, 2e6, gear=3)),
    (2.0, Command(0.01, 1.0, gear=3)),
]


def test_half_the_step_is_the_same_drive() -> None:
    """Acceleration, weave, shifts and braking end within 1e-4 of the distance and of the speed."""
    true = plant()
    end, fine = (
        driven(car, MANOEUVRE, speed=40.0, gear=4)[-1] for car in (true, replace(true, step=5e-4))
    )
    travelled = 40.0 * end.time
    assert np.hypot(end.x - fine.x, end.y - fine.y) < 1e-4 * travelled
    assert end.vx == pytest.approx(fine.vx, rel=1e-4)
    assert end.gear == 3


def test_the_same_commands_give_the_same_bits_and_leave_states_alone() -> None:
    car = plant()
    first, again = (driven(car, MANOEUVRE[:3], speed=40.0, gear=4)[-1] for _ in range(2))
    np.testing.assert_array_equal(np.hstack(first), np.hstack(again))
    state = car.start(speed=30.0, gear=3)
    before = car.motion(state)
    car.advance(state, Command(0.1, 1.0, 0.0, 4), 0.5)
    np.testing.assert_array_equal(np.hstack(car.motion(state)), np.hstack(before))


def test_it_comes_to_rest_from_a_spin() -> None:
    """Whatever the wheels do, the motion stays finite, and brakes end it."""
    commands = [(1.0, Command(0.3, 1.0, 0.0, 2)), (9.0, Command(-0.3, 0.0, 6e6, 1))]
    motions = driven(plant(), commands, speed=45.0, gear=2)
    assert np.isfinite(np.array([np.hstack(motion) for motion in motions])).all()
    last = motions[-1]
    assert np.hypot(last.vx, last.vy) < 0.01
    assert abs(last.yaw_rate) < 0.01


COMMANDS = st.builds(
    Command, st.floats(-2, 2), st.floats(0, 1), st.floats(0, 1e8), st.integers(0, 6)
)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.just(0.5), COMMANDS), max_size=6), st.floats(-30, 100))
def test_no_drive_breaks_it(commands: list[tuple[float, Command]], speed: float) -> None:
    """Any commands in range, from any speed, also backwards: finite, and never faster by itself."""
    motions = driven(plant(), commands, speed=speed)
    assert np.isfinite(np.array([np.hstack(motion) for motion in motions])).all()
    fastest = abs(speed) + 1.0 + 10.0 * motions[-1].time
    assert max(np.hypot(motion.vx, motion.vy) for motion in motions) < fastest
    assert min(motion.loads.min() for motion in motions) >= 0


@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        (Command(float("nan")), "command steering is nan; expected a finite number"),
        (Command(throttle=1.5), "command throttle is 1.5; expected 0 to 1"),
        (Command(brake=-1.0), "command brake is -1.0 Pa; expected at least 0"),
        (Command(gear=7), "command gear is 7; expected a whole number 0 to 6"),
        (Command(brake=float("inf")), "command brake is inf; expected a finite number"),
    ],
)
def test_refused_commands(command: Command, sentence: str) -> None:
    car = plant()
    with pytest.raises(ValueError) as caught:
        car.advance(car.start(speed=10.0), command, 0.01)
    assert str(caught.value) == sentence


def test_refused_settings() -> None:
    car = plant()
    with pytest.raises(ValueError, match=r"^duration is 0.0105 s; expected a multiple"):
        car.advance(car.start(), Command(), 0.0105)
    with pytest.raises(ValueError, match=r"^duration is nan s; expected a multiple"):
        car.advance(car.start(), Command(), float("nan"))
    with pytest.raises(ValueError, match=r"^step is 0.002 s; expected above 0 and at most 0.001"):
        replace(car, step=0.002)
    with pytest.raises(ValueError, match=r"^speed is nan; expected a finite number"):
        car.start(speed=float("nan"))
    with pytest.raises(ValueError, match=r"^the motion is not finite at 0.010 s; start with"):
        car.advance(car.start(speed=1e200), Command(), 0.01)
    with pytest.raises(ValueError, match=r"^tires are 2; expected 4"):
        replace(car, tires=car.tires[:2])
