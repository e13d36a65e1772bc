"""Axles at the loads that act, against the full tires at those loads."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from miho.vehicle.data import sample_tir
from miho.vehicle.driving.assembly.bench import loaded_axle
from miho.vehicle.driving.embedded import embedded_tires
from miho.vehicle.driving.known_car import inclinations, static_loads
from miho.vehicle.driving.load_transfer import LoadTransfer
from miho.vehicle.driving.loaded_axle import LoadedAxle, transfer_per_force
from miho.vehicle.driving.path_tracking import LateralModel, Weights
from miho.vehicle.driving.steering_control import AxleSlip
from miho.vehicle.models import cornering_stiffness, simplify
from miho.vehicle.models.load_scaling import PROPORTIONAL, LoadSensitivity
from tests.vehicle.driving.cars import car
from tests.vehicle.models.test_load_scaling import CURVES

CAR = car()


def stiffnesses(vx: float) -> tuple[float, float]:
    """Of the axles by the full tires, at the loads of straight running [N/rad]."""
    loads, lean = LoadTransfer(CAR.vehicle).wheel_loads(vx), inclinations(CAR.vehicle)
    wheels = []
    for tire, load, gamma in zip(embedded_tires(), loads, lean, strict=True):
        c = simplify(tire, float(load), float(gamma))
        wheels.append(cornering_stiffness(np.stack([c.B, c.C, c.D, c.E, c.Sx, c.Sy], axis=1))[0])
    return wheels[0] + wheels[1], wheels[2] + wheels[3]


@pytest.mark.parametrize("vx", [0.0, 30.0, 60.0, 85.0])
def test_axles_stiffen_with_downforce_as_their_tires_do(vx: float) -> None:
    """Within 0.5 %, where the loads double; in proportion to the load it would be 5 to 10 %."""
    found = [axle.cornering_stiffness for axle in CAR.axles(vx)]
    assert found == pytest.approx(stiffnesses(vx), rel=5e-3)


def test_the_regulator_knows_the_stiffness_at_each_speed() -> None:
    """Within 1 %, half of it by straight lines between 32 speeds."""
    model = CAR.steering_controller(Weights()).schedule.sampled.model
    for vx in (5.0, 33.0, 61.0):
        found = model.stiffnesses(vx)
        assert found == pytest.approx(stiffnesses(vx), rel=0.01)
        constant = LateralModel(car=model.car, C_f=found[0], C_r=found[1])
        for table, number in zip(model.matrices(vx), constant.matrices(vx), strict=True):
            assert np.array_equal(table, number)
    assert model.stiffnesses(60.0)[0] > 1.3 * model.stiffnesses(5.0)[0]


def test_a_turn_agrees_with_the_full_tires_at_the_loads_it_makes() -> None:
    """The axle's force that moves as much load as gives it, by bisection on the Magic Formula.

    Within 4 % of the peak: the inner wheel comes down to a tenth of the load of its curve, where
    E and the offsets, which the law keeps, have changed.
    """
    front, _ = CAR.loaded_axles
    load, transfer = 4000.0, transfer_per_force(LoadTransfer(CAR.vehicle))[0]
    lf, rf, *_ = embedded_tires()
    lean = CAR.vehicle.inclination_front

    def true(alpha: float) -> float:
        def gap(force: float) -> float:
            moved = np.clip(transfer * force, -load / 2, load / 2)
            left = lf.forces(load / 2 - moved, 0.0, alpha, lean).Fy
            return float(left + rf.forces(load / 2 + moved, 0.0, alpha, lean).Fy) - force

        return brentq(gap, -3 * load, 3 * load)

    alpha = np.linspace(-0.15, 0.15, 21)
    expected = np.array([true(slip) for slip in alpha])
    found = front.in_turn(alpha, load, transfer)
    assert np.abs(found - expected).max() < 0.04 * np.abs(expected).max()
    # The transfer costs what it costs the full tires, and nothing without sensitivity.
    still = front.at([load / 2, load / 2]).force(alpha)
    assert found.max() < 0.97 * still.max()
    assert front.in_turn(alpha, load, 0.0) == pytest.approx(still)
    alike = LoadedAxle(
        type(front.axle)(front.axle.left, front.axle.left), front.loads, PROPORTIONAL
    )
    assert alike.in_turn(alpha, load, transfer) == pytest.approx(
        alike.at([load / 2, load / 2]).force(alpha), abs=1e-6
    )


def test_an_axle_of_property_data_holds_at_the_loads_of_the_car() -> None:
    """At rest the front axle carries half of the load of the samples: its peaks are within 3 % of
    the full tires', its stiffness within 7 %. As sampled they are 77 to 84 % too large, and the
    peaks in proportion to the load 8 to 9 % too small."""
    data, thetas = [sample_tir("lf"), sample_tir("rf")], [np.array(CURVES[t][1]) for t in CURVES]
    axle = loaded_axle(data, thetas[:2])
    assert axle.loads == pytest.approx([2610.0, 3900.0], rel=1e-3)
    alpha, loads = np.linspace(-0.2, 0.2, 401), static_loads(CAR.vehicle)[:2]
    lf, rf, *_ = embedded_tires()
    lean = CAR.vehicle.inclination_front
    true = lf.forces(loads[0], 0.0, alpha, lean).Fy + rf.forces(loads[1], 0.0, alpha, lean).Fy
    found, sampled = axle.at(loads).force(alpha), axle.axle.force(alpha)
    in_proportion = LoadedAxle(axle.axle, axle.loads, PROPORTIONAL).at(loads).force(alpha)
    for end in (np.max, np.min):
        assert end(found) == pytest.approx(end(true), rel=0.03)
        assert end(sampled) / end(true) > 1.7
        assert end(in_proportion) / end(true) < 0.95
    stiffness = stiffnesses(0.0)[0]
    assert axle.at(loads).cornering_stiffness == pytest.approx(stiffness, rel=0.07)
    assert axle.axle.cornering_stiffness > 1.7 * stiffness


def test_a_transfer_without_end_is_refused() -> None:
    front, _ = CAR.loaded_axles
    steep = LoadedAxle(front.axle, front.loads, LoadSensitivity(np.full(2, -0.9), np.full(2, -0.9)))
    with pytest.raises(ValueError, match=r"transfer is 50; expected a smaller load transfer"):
        steep.in_turn(np.linspace(-0.2, 0.2, 401), 3000.0, 50.0)


def test_the_slip_for_a_force_is_that_of_the_axle_at_its_load() -> None:
    """At 1.4 times the load, by the mean of the tires' sensitivities, to 1 mrad below the peaks."""
    front, _ = CAR.loaded_axles
    static = static_loads(CAR.vehicle)[:2]
    slip = CAR.steering_controller(Weights()).front
    loaded = front.at(1.4 * static)
    for alpha in (-0.05, -0.02, 0.0, 0.03, 0.05):
        force = float(loaded.force(alpha))
        assert slip.at(force, 1.4 * float(static.sum())) == pytest.approx(alpha, abs=1e-3)
        in_proportion = AxleSlip.of(front.at(static), float(static.sum()))
        if abs(alpha) >= 0.05:
            assert abs(in_proportion.at(force, 1.4 * float(static.sum())) - alpha) > 2e-3
