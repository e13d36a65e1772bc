"""Wheel loads: balances of force and moment, the paper's reading, lifted wheels."""

import numpy as np
import pytest
from scipy.constants import g

from miho.vehicle.driving.embedded import embedded_tires
from miho.vehicle.driving.load_transfer import LoadTransfer
from miho.vehicle.driving.vehicle import Vehicle
from tests.vehicle.driving.test_vehicle import av21


@pytest.fixture(scope="module")
def car() -> Vehicle:
    return Vehicle.from_settings(av21())


def test_force_and_both_moments_balance(car: Vehicle) -> None:
    """Sums over the wheels against the whole car, at 200 random states that lift no wheel."""
    rng = np.random.default_rng(0)
    vx, ax, ay = (rng.uniform(low, high, 200) for low, high in ((0, 80), (-8, 8), (-12, 12)))
    down = rng.uniform(9, 14, 200)
    fl, fr, rl, rr = LoadTransfer(car).wheel_loads(vx, ax, ay, gravity=down)
    assert min(map(np.min, (fl, fr, rl, rr))) > 0
    downforce = (car.C_l_front + car.C_l_rear) * vx**2
    np.testing.assert_allclose(fl + fr + rl + rr, car.mass * down + downforce, rtol=1e-13)
    roll = (fr - fl) * car.track_front / 2 + (rr - rl) * car.track_rear / 2
    np.testing.assert_allclose(roll, car.mass * ay * car.h_cg, rtol=1e-10, atol=1e-9)
    aero = (car.C_l_rear * car.lr - car.C_l_front * car.lf) * vx**2
    pitch = (rl + rr) * car.lr - (fl + fr) * car.lf - aero
    np.testing.assert_allclose(pitch, car.mass * ax * car.h_cg, rtol=1e-10, atol=1e-8)


def test_the_parts_by_hand(car: Vehicle) -> None:
    """Each part from its own lever, with h_a from the heights of the sprung mass."""
    sprung_front = car.mass * car.lr / car.wheelbase - car.unsprung_mass_front
    sprung_rear = car.mass * car.lf / car.wheelbase - car.unsprung_mass_rear
    m_s = sprung_front + sprung_rear
    hubs = (
        car.unsprung_mass_front * car.wheel_radius_front + car.unsprung_mass_rear * car.wheel_radius
    )
    h_s = (car.mass * car.h_cg - hubs) / m_s
    axis = (sprung_front * car.roll_centre_front + sprung_rear * car.roll_centre_rear) / m_s
    front, rear = LoadTransfer(car).lateral_parts
    couple = m_s * (h_s - axis)
    assert front.elastic == pytest.approx(car.roll_share_front * couple / 1.639, rel=1e-12)
    assert rear.elastic == pytest.approx((1 - car.roll_share_front) * couple / 1.524, rel=1e-12)
    assert rear.geometric == pytest.approx(sprung_rear * 0.05 / 1.524, rel=1e-12)
    assert front.unsprung == pytest.approx(55 * 0.298 / 1.639, rel=1e-12)


def test_as_printed_forgets_steady_cornering(car: Vehicle) -> None:
    printed = LoadTransfer(car, as_printed=True)
    at_rest = LoadTransfer(car).wheel_loads(0.0)
    assert printed.wheel_loads(60.0, ax=3.0, ay=10.0) == at_rest
    left, right, *_ = printed.wheel_loads(60.0, vy_rate=10.0)
    front, _ = printed.lateral_parts
    assert (right - left) / 2 == pytest.approx(10 * front.elastic)


def test_a_lifted_wheel_leaves_its_load_to_the_other(car: Vehicle) -> None:
    loads = LoadTransfer(car).wheel_loads([5.0, 5.0], ax=0.0, ay=[60.0, -60.0])
    axle = car.mass * g * car.lr / car.wheelbase + car.C_l_front * 25
    np.testing.assert_allclose(loads.front_left, [0.0, axle])
    np.testing.assert_allclose(loads.front_right, [axle, 0.0])
    assert LoadTransfer(car).wheel_loads(0.0, ax=200.0).front_left == 0


@pytest.mark.parametrize("speed", [40.0, 60.0, 80.0])
def test_the_front_axle_of_the_av21_reaches_its_limit_first(car: Vehicle, speed: float) -> None:
    """In a left turn on a flat road; an axle's limit is where its peak force turns its share.

    The lateral acceleration at which an axle slides, by fixed point on the loads.
    """
    tires, alpha = embedded_tires(), np.linspace(-0.25, 0.25, 501)
    limits = []
    for first, gamma, arm in (
        (0, car.inclination_front, car.lr),
        (2, car.inclination_rear, car.lf),
    ):
        ay = 10.0
        for _ in range(40):
            loads = LoadTransfer(car).wheel_loads(speed, 0.0, ay)
            peak = max(
                sum(tires[i].forces(loads[i], 0.0, alpha, gamma).Fy for i in (first, first + 1))
            )
            ay = (ay + peak / (car.mass * arm / car.wheelbase)) / 2
        limits.append(ay)
    assert limits[0] < limits[1]
