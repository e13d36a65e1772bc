"""Feed-forward and feedback of the steering."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import g

from miho.vehicle.driving.friction import demand
from miho.vehicle.driving.path_tracking import Weights
from miho.vehicle.driving.segments import Segment, track_of
from miho.vehicle.driving.steering_control import AxleSlip, TrackingError, tracking_error
from miho.vehicle.driving.track import Projection
from miho.vehicle.models import Axle
from tests.vehicle.driving.cars import car

CAR = car()
CONTROL = CAR.steering_controller(Weights())
LINEAR = np.array([0.5, 1.0, 2e5, 0.0, 0.0])  # B C D = 1e5 N/rad, straight for small angles


def test_the_slip_of_an_axle_inverts_its_force_and_grows_with_the_load() -> None:
    slip = AxleSlip.of(CAR.front, 3356.0)
    for alpha in (-0.06, -0.01, 0.0, 0.02, 0.05):
        force = float(CAR.front.force(alpha))
        assert slip.at(force, 3356.0) == pytest.approx(alpha, abs=1e-5)
        assert slip.at(2 * force, 6712.0) == pytest.approx(alpha, abs=1e-5)
    peak = slip.at(1e9, 3356.0)
    assert float(CAR.front.force(peak)) == pytest.approx(slip.force.max(), rel=1e-3)


def test_a_curve_of_the_other_sign_convention_is_refused() -> None:
    with pytest.raises(ValueError, match="falls with the slip angle between its peaks"):
        AxleSlip.of(Axle(-LINEAR * [1, 1, 1, 0, 0] + 0, LINEAR * [1, 1, -1, 0, 0]), 3000.0)


def test_feed_forward_is_the_steady_turn_of_the_single_track_model() -> None:
    """delta = L kappa + m a (l_r / C_f - l_f / C_r) / L for linear tires at their own load."""
    vehicle = CAR.vehicle
    axle = Axle(LINEAR, LINEAR)
    vx, curvature, bank = 30.0, 1 / 400.0, 0.1
    lateral, gravity = (float(part) for part in demand(vx, curvature, bank))
    weight = vehicle.mass * gravity / vehicle.wheelbase
    load_f = weight * vehicle.lr + vehicle.C_l_front * vx**2
    load_r = weight * vehicle.lf + vehicle.C_l_rear * vx**2
    control = CAR.steering_controller(Weights())
    linear = type(control)(
        vehicle, control.schedule, AxleSlip.of(axle, load_f), AxleSlip.of(axle, load_r)
    )
    turn = linear.feed_forward(vx, curvature, bank)
    bend, C = curvature * math.cos(bank), axle.cornering_stiffness
    force = vehicle.mass * lateral / vehicle.wheelbase
    slip_r = -force * vehicle.lf / C
    expected = bend * vehicle.wheelbase + force * (vehicle.lr - vehicle.lf) / C
    assert turn.steering == pytest.approx(expected, rel=2e-3)
    assert turn.slip == pytest.approx(bend * vehicle.lr + slip_r, abs=2e-5)


def test_weight_alone_steers_on_a_bank() -> None:
    """At the neutral speed v^2 kappa cos b = g sin b the tires have nothing to do."""
    bank, curvature = 0.2, 1 / 300.0
    neutral = math.sqrt(g * math.tan(bank) / curvature)
    assert float(demand(neutral, curvature, bank).lateral) == pytest.approx(0.0, abs=1e-12)
    turn = CONTROL.feed_forward(neutral, curvature, bank)
    idle = CONTROL.feed_forward(neutral, 0.0, 0.0)
    bend = curvature * math.cos(bank)
    assert turn.steering - idle.steering == pytest.approx(bend * CAR.vehicle.wheelbase, abs=2e-4)


def test_errors_are_those_of_eq_13() -> None:
    ring = track_of("ring", [Segment(length=200 * math.pi, curvature=(0.01, 0.01))])
    at = Projection(50.0, 2.0)
    heading = float(ring.at(50.0).heading)
    error = tracking_error(ring, at, heading + 0.1 + math.tau, 20.0, 0.5, 0.3)
    assert error.e_y == 2.0
    assert error.e_psi == pytest.approx(0.1)
    assert error.e_y_rate == pytest.approx(0.5 * math.cos(0.1) + 20 * math.sin(0.1))
    along = (20 * math.cos(0.1) - 0.5 * math.sin(0.1)) / (1 - 0.02)
    assert error.e_psi_rate == pytest.approx(0.3 - 0.01 * along)


@pytest.mark.parametrize("vx", [0.0, 1.0, 2.9, 3.1, 40.0])
def test_left_of_the_path_it_steers_to_the_right(vx: float) -> None:
    """Also below 3 m/s, where the path is followed by geometry; never beyond the stop."""
    ring = track_of("ring", [Segment(length=2000 * math.pi, curvature=(1e-3, 1e-3))])
    wheel = CONTROL.feed_forward(max(vx, 3.0), 1e-3, 0.0).steering
    on, off = (
        CONTROL.command(
            CONTROL.initial, ring, Projection(10.0, e), TrackingError(e, 0.0, 0.0, 0.0), vx, wheel
        )[0]
        for e in (0.0, 1.0)
    )
    assert off < on
    far = TrackingError(50.0, 0.0, 0.5, 0.0)
    most, _ = CONTROL.command(CONTROL.initial, ring, Projection(10.0, 50.0), far, vx, 0.0)
    assert most == -CAR.vehicle.steering_max


def test_no_command_turns_faster_than_the_rack() -> None:
    """Whatever the errors jump to; without an estimator too, for which they are the state."""
    ring = track_of("ring", [Segment(length=2000 * math.pi, curvature=(1e-3, 1e-3))])
    largest = CAR.vehicle.steering_rate * CONTROL.schedule.sampled.period
    for control in (CONTROL, replace(CONTROL, estimator=None)):
        commands, state = [], control.initial
        for e in (0.0, 0.0, 2.0, -2.0, 2.0, 2.0, 2.0):
            error = TrackingError(e, 0.0, 0.0, 0.0)
            u, state = control.command(state, ring, Projection(10.0, e), error, 30.0, 0.0)
            commands.append(u)
        turns = np.abs(np.diff(commands))
        assert turns.max() == pytest.approx(largest)
        assert (turns <= largest + 1e-12).all()


def test_the_estimator_leaves_a_steady_turn_alone() -> None:
    """On the path and as the feed-forward has it, the command stays the feed-forward."""
    ring = track_of("ring", [Segment(length=2000 * math.pi, curvature=(1e-3, 1e-3))])
    turn = CONTROL.feed_forward(30.0, 1e-3, 0.0)
    error, state = TrackingError(0.0, 0.0, -turn.slip, 0.0), CONTROL.initial
    for _ in range(20):
        u, state = CONTROL.command(state, ring, Projection(10.0, 0.0), error, 30.0, turn.steering)
        # The ring is sampled, so that its curvature is 1e-3 but for some 1e-9.
        assert u == pytest.approx(turn.steering, abs=1e-6)
