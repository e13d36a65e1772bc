"""The printed equations against hand computations, and what they do to a plan."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import g

from miho.vehicle.driving.as_printed import PrintedPlanner
from miho.vehicle.driving.embedded import embedded_plant
from miho.vehicle.driving.grip import Grip
from miho.vehicle.driving.ovals import lvms
from miho.vehicle.driving.plant import Motion
from miho.vehicle.driving.velocity_planner import VelocityPlanner
from tests.vehicle.driving.test_velocity_planner import CAR, PLAIN, equal_grip, ring

TRACK = ring(150.0, 0.0)
LOADS = np.array([1678.12, 1678.12, 2244.54, 2244.54])
LEFT, RIGHT = np.array([3000.0, 3600, 4500, 5000]), np.array([3500.0, 3100, 4900, 4400])
GRIP = Grip(LOADS, LEFT, RIGHT, LEFT, np.full(4, -0.2), np.full(4, -0.2))
PLANNER = PrintedPlanner(CAR.vehicle, GRIP, mu=0.7)


def motion(vx: float, yaw_rate: float, vy_rate: float, steering: float, bank: float) -> Motion:
    """A car with these; its accelerometer feels v_y' + v_x psi' less what weight does."""
    plant = embedded_plant(CAR.vehicle)
    ay = vy_rate + vx * yaw_rate - g * math.sin(bank)
    still = plant.motion(plant.start(speed=vx))
    return still._replace(yaw_rate=yaw_rate, ay=ay, steering=steering)


@pytest.mark.parametrize("bank", [0.0, 0.3])
def test_the_printed_equations_by_hand(bank: float) -> None:
    """v_y' = 2 m/s^2, 25 m/s, 0.1 rad/s and 0.05 rad on a left bend of 250 m.

    m_s h_a = 800 * 0.29 - 287.242 * 0.03 - 387.758 * 0.05 - 55 * 0.298 - 70 * 0.31 = 165.905 kg m,
    with the heights of the AV-21; C_roll = 331.81 N m, of which 0.65 / 1.639 m = 131.591 N move at
    the front and 0.35 / 1.524 m = 76.203 N at the rear. The numbers have six digits.
    """
    front = 0.7 * ((1678.12 - 131.591) / 1678.12 * 3000 + (1678.12 + 131.591) / 1678.12 * 3600)
    rear = 0.7 * ((2244.54 - 76.203) / 2244.54 * 4500 + (2244.54 + 76.203) / 2244.54 * 5000)
    assert (front, rear) == (pytest.approx(4652.93, abs=0.01), pytest.approx(6661.88, abs=0.01))
    ay_max = (rear + front * math.cos(0.05)) / 800 - 25 * 0.1
    expected = math.sqrt(ay_max / (1 / 250))
    assert expected == pytest.approx(53.9357, abs=1e-4)
    v = PLANNER.speed(motion(25.0, 0.1, 2.0, 0.05, bank), 1 / 250, bank)
    assert v == pytest.approx(expected, rel=1e-5)


def test_a_right_bend_is_a_left_bend_in_a_mirror() -> None:
    """With the sides of the car exchanged too."""
    swap = [1, 0, 3, 2]
    mirrored = replace(PLANNER, grip=replace(GRIP, right=LEFT[swap], left=RIGHT[swap]))
    left = PLANNER.speed(motion(25.0, 0.1, 2.0, 0.05, 0.0), 1 / 250)
    right = mirrored.speed(motion(25.0, -0.1, -2.0, -0.05, 0.0), -1 / 250)
    assert right == pytest.approx(left, rel=1e-12)


def test_where_the_equations_have_no_value() -> None:
    """No root of a negative a_y,max, and no curvature on a straight."""
    spinning = motion(40.0, 1.0, 0.0, 0.0, 0.0)
    assert PLANNER.speed(spinning, 1 / 250) == 0.0
    assert replace(PLANNER, yaw_term=False).speed(spinning, 1 / 250) > 50.0
    assert PLANNER.speed(motion(40.0, 0.0, 0.0, 0.0, 0.0), 0.0) == PLANNER.top_speed


def test_a_car_on_the_plan_has_the_speed_of_the_plan() -> None:
    """In a steady turn the two ways to read Eq. 10-12 agree, and 1 m/s too much is answered."""
    kappa = 1 / 150
    v = float(PLANNER.plan(TRACK).v[0])
    steady = motion(v, v * kappa, 0.0, CAR.vehicle.wheelbase * kappa, 0.0)
    assert PLANNER.speed(steady, kappa) == pytest.approx(v, rel=1e-9)
    faster = motion(v + 1, (v + 1) * kappa, 0.0, CAR.vehicle.wheelbase * kappa, 0.0)
    assert PLANNER.speed(faster, kappa) == pytest.approx(v - 1, abs=0.1)


def test_eq_11_gives_0_707_of_the_speed() -> None:
    """Without load sensitivity and air the corrected limit is sqrt(mu g R)."""
    printed = PrintedPlanner(PLAIN, equal_grip(), mu=0.9).speeds(TRACK)
    mended = PrintedPlanner(PLAIN, equal_grip(), mu=0.9, yaw_term=False).speeds(TRACK)
    limit = VelocityPlanner(PLAIN, equal_grip(), mu=0.9).plan(TRACK).v
    assert limit == pytest.approx(math.sqrt(0.9 * g * 150))
    # cos(delta) takes 2e-4 of the front axle's force.
    assert mended == pytest.approx(limit, rel=2e-4)
    assert printed / mended == pytest.approx(math.sqrt(0.5))


def test_eq_10_makes_load_transfer_cancel() -> None:
    """With equal tires exactly; with the embedded ones, which differ, all but 0.1 %."""
    for grip, most in ((equal_grip(), 1e-12), (CAR.grip, 1e-3)):
        still, moved = (
            PrintedPlanner(PLAIN, grip, transfer=transfer).speeds(TRACK)
            for transfer in (False, True)
        )
        assert np.abs(moved / still - 1).max() < most


def test_straights_have_the_top_speed_and_right_turns_their_own_peaks() -> None:
    line = TRACK
    planner = PrintedPlanner(CAR.vehicle, CAR.grip, top_speed=20.0)
    assert planner.speeds(line) == pytest.approx(20.0)


def test_the_printed_plan_holds_its_limit_and_brakes_for_nothing() -> None:
    """At the limit wherever Eq. 12 counts; into the bends of LVMS faster than brakes can follow."""
    plan = PrintedPlanner(CAR.vehicle, CAR.grip, top_speed=62.0).plan(lvms(step=8.0))
    limited = plan.v < 62.0
    assert limited.any()
    assert not limited.all()
    assert plan.use[limited] == pytest.approx(1.0)
    assert (plan.use[~limited] <= 1.0).all()
    assert plan.friction.C_d == CAR.vehicle.C_d, "a drive is evaluated with its drag"
    following = np.roll(plan.v, -1) ** 2
    assert plan.v**2 + 2 * plan.ax * plan.line.step == pytest.approx(following)
    assert plan.ax.min() < -12.0


@pytest.mark.parametrize(("setting", "value"), [("mu", 0.0), ("top_speed", math.nan)])
def test_bad_settings_are_refused(setting: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{setting} is {value:g}"):
        replace(PLANNER, **{setting: value})
