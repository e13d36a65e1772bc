"""Velocity plans: closed forms, and limits that an independent computation finds kept."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.constants import g

from miho.vehicle.driving.friction import demand, measured_use
from miho.vehicle.driving.grip import Grip
from miho.vehicle.driving.load_transfer import LoadTransfer
from miho.vehicle.driving.ovals import lvms
from miho.vehicle.driving.plant import Command
from miho.vehicle.driving.road import PLANE
from miho.vehicle.driving.segments import Segment, track_of
from miho.vehicle.driving.track import Track
from miho.vehicle.driving.velocity_planner import (
    VelocityPlan,
    VelocityPlanner,
    entries,
    front_share,
    full_throttle,
)
from tests.vehicle.driving.cars import car
from tests.vehicle.driving.plants import circle, driven, plant

LVMS = lvms(step=8.0)
CAR = car()
PLAIN = replace(CAR.vehicle, C_l_front=0.0, C_l_rear=0.0)


def equal_grip(sensitivity: float = 0.0) -> Grip:
    """Tires with a force as large as their load, at 2000 N."""
    force, q = np.full(4, 2000.0), np.full(4, sensitivity)
    return Grip(force, force, force, force, q, q)


def ring(radius: float, bank: float) -> Track:
    bend = (1 / radius, 1 / radius)
    lap = Segment(length=math.tau * radius, curvature=bend, bank=(bank, bank))
    return track_of("ring", [lap], step=10.0)


@pytest.mark.parametrize(("bank", "expected"), [(0.0, 47.8), (20.0, 70.0)])
def test_a_banked_ring_has_the_closed_form(bank: float, expected: float) -> None:
    """v^2 = g R (mu + tan b) / (1 - mu tan b): the speeds of the literature, and to 1e-9."""
    plan = VelocityPlanner(PLAIN, equal_grip()).plan(ring(233.0, math.radians(bank)))
    tan = math.tan(math.radians(bank))
    v = math.sqrt(g * 233.0 * (1 + tan) / (1 - tan))
    assert v == pytest.approx(expected, abs=0.05)
    assert plan.v == pytest.approx(v, rel=1e-9)
    assert plan.use == pytest.approx(1.0, abs=1e-9)
    assert plan.ax == pytest.approx(0.0, abs=1e-9)


def test_a_reserve_lowers_the_speeds_and_not_the_limit() -> None:
    """The speeds are those of a smaller mu, and their use of the whole one is 1 less the reserve.

    On a flat ring without downforce the use is in proportion to the lateral acceleration.
    """
    flat = ring(233.0, 0.0)
    planner = VelocityPlanner(PLAIN, equal_grip(), mu=0.8)
    kept = replace(planner, reserve=0.25).plan(flat)
    assert kept.v == pytest.approx(replace(planner, mu=0.6).plan(flat).v, rel=1e-9)
    assert kept.use == pytest.approx(0.75, abs=1e-9)
    assert kept.limit == pytest.approx(0.8 * g, rel=1e-9)
    with pytest.raises(ValueError, match="reserve is 1; expected at least 0 and below 1"):
        replace(planner, reserve=1.0)


def test_a_reserve_at_the_entry_holds_until_the_turn_has_shown_the_grip() -> None:
    """The entry and the braking before it use less grip; the end of the turn has the full speed."""
    line = lvms(step=5.0, flat=True)
    planner = CAR.planner(0.7, 80.0)
    full, kept = (replace(planner, entry_reserve=reserve).plan(line) for reserve in (0.0, 0.2))
    entry = np.flatnonzero(entries(line))
    assert (kept.v <= full.v + 1e-9).all()
    assert kept.use[entry[:-1]].max() < 0.8 + 1e-3
    assert full.use[entry].max() > 0.99
    last = entry[-1]  # of the second turn, which begins at once
    before, end = int(1580 / line.step), int(2100 / line.step)
    assert before < last < end
    assert kept.v[before] < full.v[before] - 3.0
    assert kept.use[before] < 0.8 + 1e-3
    assert kept.v[end] == pytest.approx(full.v[end], abs=0.1)
    assert not entries(ring(233.0, 0.0)).any()
    with pytest.raises(ValueError, match="entry_reserve is 1; expected at least 0 and below 1"):
        replace(planner, entry_reserve=1.0)


def test_downforce_adds_to_the_closed_form() -> None:
    """m v^2 / R = mu (m g + C_l v^2), with downforce at the centre of gravity."""
    front = CAR.vehicle.lr / CAR.vehicle.wheelbase
    winged = replace(PLAIN, C_l_front=front, C_l_rear=1 - front)
    plan = VelocityPlanner(winged, equal_grip(), mu=0.8).plan(ring(100.0, 0.0))
    expected = math.sqrt(0.8 * g / (1 / 100.0 - 0.8 / winged.mass))
    assert plan.v == pytest.approx(expected, rel=1e-9)


def test_load_transfer_costs_speed_only_with_load_sensitivity() -> None:
    """Eq. 10 lets it cancel on axles with equal tires; a lower centre of gravity then gains 0."""
    low, high = (replace(PLAIN, h_cg=h_cg) for h_cg in (0.2, 0.5))
    track = ring(100.0, 0.0)
    for sensitivity, gains in ((0.0, False), (-0.2, True)):
        grip = equal_grip(sensitivity)
        high_plan, low_plan = (VelocityPlanner(v, grip).plan(track) for v in (high, low))
        gain = low_plan.v[0] / high_plan.v[0] - 1
        assert (gain > 0.005) == gains
        if not gains:
            assert gain == pytest.approx(0.0, abs=1e-9)


def used(planner: VelocityPlanner, plan: VelocityPlan) -> np.ndarray:
    """Use of the worse axle's ellipse from each point to the next, written anew."""
    vehicle, line, v = planner.vehicle, plan.line, plan.v
    ax = (np.roll(v, -1) ** 2 - v**2) / (2 * line.step)
    turning = v**2 * line.curvature
    ay = turning * np.cos(line.bank) - g * np.sin(line.bank)
    gravity = g * np.cos(line.bank) + turning * np.sin(line.bank)
    loads = LoadTransfer(vehicle).wheel_loads(v, ax, ay, gravity=gravity)
    return use_of(planner, v, ax, ay, np.stack(loads, axis=1))


def use_of(
    planner: VelocityPlanner, v: np.ndarray, ax: np.ndarray, ay: np.ndarray, loads: np.ndarray
) -> np.ndarray:
    """Use of the worse axle's ellipse at loads (n, 4)."""
    vehicle, grip = planner.vehicle, planner.grip
    force = vehicle.mass * ax + vehicle.C_d * v**2
    x = loads / grip.load
    sideways = np.where(ay[:, None] >= 0, grip.left, grip.right)
    y = planner.mu * x * sideways * (1 + grip.lateral_sensitivity * (x - 1))
    along = planner.mu * x * grip.drive * (1 + grip.longitudinal_sensitivity * (x - 1))
    brake = front_share(CAR.brake)
    share = np.where(force[:, None] < 0, [brake, 1 - brake], [0.0, 1.0])
    carried = np.array([vehicle.lr, vehicle.lf]) / vehicle.wheelbase * vehicle.mass * ay[:, None]
    axles = [peaks.reshape(-1, 2, 2).sum(axis=2) for peaks in (y, along)]
    uses = np.hypot(carried / axles[0], share * force[:, None] / axles[1])
    return np.asarray(uses.max(axis=1))


BANK = math.radians(20.0)


@pytest.mark.parametrize(
    ("start", "command", "curvature"),
    [
        ({"speed": 60.0, "gear": 6}, Command(throttle=0.48, gear=6), 0.0),
        ({"speed": 45.0, "gear": 4}, Command(throttle=1.0, gear=4), 0.0),
        ({"speed": 70.0, "gear": 0}, Command(brake=3e6, gear=0), 0.0),
        ({"speed": 45.0, "gear": 4}, Command(steering=0.02, throttle=0.2, gear=4), 0.0),
        ({"speed": 60.0, "gear": 6}, Command(steering=0.016, throttle=0.4, gear=6), 1 / 233),
    ],
    ids=["steady", "full throttle", "braking", "turn", "banked turn"],
)
def test_the_planned_use_has_the_loads_of_the_plant(
    start: dict[str, float], command: Command, curvature: float
) -> None:
    """The use of the friction by a motion is the use by the loads of the simulated car, to 0.2 %.

    The loads of the plant lag, and the car is beside the line of the banked turn. A moment of the
    drag in addition to that in the downforce would change the use by 1.4 % or more.
    """
    bank = BANK if curvature else 0.0
    road = circle(1 / curvature, bank) if curvature else PLANE
    m = driven(replace(plant(), road=road), [(1.0, command)], **start)[-1]
    planner = CAR.planner()
    v, ax, ay = np.array([[m.vx], [m.ax], [m.ay]])
    gravity = demand(v, curvature, bank).gravity
    use = measured_use(planner.friction, v, ax, ay, gravity)
    assert use == pytest.approx(use_of(planner, v, ax, ay, m.loads[None]), rel=2e-3)


@settings(max_examples=10, deadline=None)
@given(
    mu=st.floats(0.45, 1.1),
    top=st.floats(30.0, 90.0),
    loads=st.floats(0.5, 1.5),
    strength=st.floats(0.5, 1.2),
)
def test_energy_and_friction_limits_hold_at_every_point(
    mu: float, top: float, loads: float, strength: float
) -> None:
    """On LVMS and on a road with hairpins of 40 m, where braking is needed."""
    tight = [
        Segment(length=150.0),
        Segment(length=60.0, curvature=(0.0, 0.025)),
        Segment(length=math.pi / 0.025 - 60.0, curvature=(0.025, 0.025)),
        Segment(length=60.0, curvature=(0.025, 0.0)),
        Segment(length=150.0),
    ]
    hairpins = track_of("hairpins", tight + tight, step=4.0)
    weaker = replace(CAR.grip, load=CAR.grip.load * loads, left=CAR.grip.left * strength)
    planner = replace(CAR.planner(mu, top), grip=weaker)
    mass = CAR.vehicle.mass
    for track in (LVMS, hairpins):
        try:
            plan = planner.plan(track)
        except ValueError as error:
            assert "no speed holds the car" in str(error)
            continue
        assert plan.v.max() <= top + 1e-9
        use = used(planner, plan)
        assert use.max() <= 1 + 1e-6
        assert plan.use == pytest.approx(use, abs=1e-6)
        drag = CAR.vehicle.C_d * plan.v**2 + CAR.vehicle.C_r
        power = (mass * plan.ax + drag) * plan.v
        strongest = (CAR.engine.table * CAR.engine.speeds).max()
        assert (power <= strongest + 1e-6).all(), "more power than the engine has"
        assert (-mass * plan.ax <= 0.9 * CAR.brake.largest_force + drag + 1e-3 * mass).all()


def test_the_plan_brakes_before_the_bend_and_runs_into_a_limit_everywhere() -> None:
    """A plan with slack everywhere could be faster: some limit is met at each point."""
    plan = CAR.planner(0.5, 80.0).plan(LVMS)
    assert plan.ax.min() < -1.0
    speeds = np.arange(1.0, 90.0)
    engine = np.interp(plan.v, speeds, full_throttle(CAR.vehicle, CAR.engine, speeds))
    tight = (plan.use > 0.999) | (plan.v > 79.9) | (plan.ax > engine - 0.05)
    before_a_brake_limit = plan.ax < -0.9 * CAR.brake.largest_force / CAR.vehicle.mass
    assert (tight | before_a_brake_limit).mean() > 0.99


def test_the_plan_between_points_is_uniformly_accelerated() -> None:
    plan = CAR.planner(0.5, 80.0).plan(LVMS)
    i = int(np.argmin(plan.ax))
    s = plan.line.s[i] + 0.25 * plan.line.step
    v, ax = plan.at(s + plan.line.length)
    assert ax == plan.ax[i]
    assert v**2 == pytest.approx(0.75 * plan.v[i] ** 2 + 0.25 * plan.v[i + 1] ** 2)
    fine = sum(plan.line.step / 50 / plan.at(k * plan.line.step / 50)[0]
               for k in range(50 * plan.v.size))  # fmt: skip
    assert plan.lap_time == pytest.approx(fine, rel=1e-4)


def test_a_car_that_drives_the_plan_is_measured_to_use_its_friction() -> None:
    """An accelerometer does not feel rolling resistance, which is a force of the tires."""
    plan = CAR.planner(0.5, 80.0).plan(LVMS)
    gravity = demand(plan.v, LVMS.curvature, LVMS.bank).gravity
    use = measured_use(plan.friction, plan.v, plan.ax, plan.lateral, gravity)
    assert use == pytest.approx(plan.use, rel=1e-12)


def test_a_road_too_steep_or_too_tight_is_refused() -> None:
    planner = VelocityPlanner(PLAIN, equal_grip(), mu=0.1)
    with pytest.raises(ValueError, match=r"no speed holds the car on steep at s = "):
        track = ring(300.0, 0.0)
        planner.plan(replace(track, name="steep", bank=np.where(track.s < 100, -0.5, 0.0)))
    for wrong in ({"mu": 0.0}, {"top_speed": -1.0}, {"brake_share": math.nan}):
        with pytest.raises(ValueError, match="expected a positive number"):
            VelocityPlanner(PLAIN, equal_grip(), **wrong)
