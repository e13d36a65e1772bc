"""What the road's friction leaves of a car's forces, on both plants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from miho.vehicle.driving.compiled_tire import wheel_forces, wheel_tire
from miho.vehicle.driving.compiling import compiled
from miho.vehicle.driving.ovals import ims
from miho.vehicle.driving.plant import Command
from miho.vehicle.driving.road import PLANE, road_of
from tests.vehicle.driving.multi_body import MultiBody
from tests.vehicle.driving.plants import driven, plant, symmetric

SLIP = np.linspace(0.0, 0.35, 351)
RAMP = [(0.02, Command(steering=angle, gear=0)) for angle in np.linspace(0.0, 0.3, 150)]
"""Steering until the front tires slide."""


@compiled
def one_wheel(p, load, kappa, alpha, Vx, friction):  # type: ignore[no-untyped-def]
    return wheel_forces(p, load, kappa, alpha, Vx, friction)


def test_friction_is_that_of_the_scaling_factors() -> None:
    """LMUX and LMUY, by which MF-Tyre takes the friction of a road: `MagicFormula` knows both."""
    tire = plant().tires[0]
    scaled = replace(tire, parameters=replace(tire.parameters, LMUX=0.4, LMUY=0.4))
    rng = np.random.default_rng(0)
    for load, kappa, alpha in rng.uniform((500, -0.3, -0.3), (6000, 0.3, 0.3), (50, 3)):
        expected = scaled.forces(load, kappa, alpha, 0.0, 30.0)
        forces = one_wheel(wheel_tire(tire), load, kappa, alpha, 30.0, 0.4)
        assert forces == pytest.approx((float(expected.Fx), float(expected.Fy)), rel=1e-9, abs=1e-6)


def test_a_car_reaches_the_share_of_its_grip_that_the_road_gives_and_no_more() -> None:
    """The bound is the sum of what `MagicFormula` says the tires could give at the same loads.

    Within 1e-3, for the forces along the front wheels, which a turned wheel has across the car. On
    half of the friction the car has half of the lateral acceleration; less load transfer gives
    tires whose peaks rise less than their load some 3 % back.
    """
    largest = {}
    for friction in (1.0, 0.5, 0.2):
        car = symmetric(PLANE._replace(friction=friction))
        motions = driven(car, RAMP, speed=30.0, gear=0)
        felt = np.array([abs(motion.ay) for motion in motions]) * car.vehicle.mass
        loads = np.array([motion.loads for motion in motions])
        tires = zip(car.tires, loads.T, strict=True)
        peaks = sum(
            abs(tire.forces(load[:, None], 0.0, SLIP).Fy).max(axis=1) for tire, load in tires
        )
        share = float((felt / peaks).max()) / friction
        assert 0.8 < share < 1 + 1e-3
        largest[friction] = felt.max()
    assert largest[0.5] == pytest.approx(0.5 * largest[1.0], rel=0.05)
    assert largest[0.2] == pytest.approx(0.2 * largest[1.0], rel=0.05)


def test_the_other_plant_slides_on_the_same_road() -> None:
    """CommonRoad's tire has peaks of p_dy1 times its load, so a_y is at most friction p_dy1 g."""
    pytest.importorskip("vehiclemodels")
    true = plant()
    dry = MultiBody(true.vehicle, true.engine, true.brake)
    car = replace(dry, road=PLANE._replace(friction=0.5))
    for knows, of in zip(car.axles, dry.axles, strict=True):
        assert knows.left == pytest.approx(of.left), "controllers know the tires, not the road"
    state, felt = car.start(speed=20.0, gear=0), []
    for _, command in RAMP[:100]:
        state = car.advance(state, command, 0.02)
        felt.append(abs(car.motion(state).ay))
    assert 0.9 < max(felt) / (0.5 * car.parameters.tire.p_dy1 * 9.81) < 1.02


@pytest.mark.parametrize("friction", [0.0, -1.0, float("nan"), float("inf")])
def test_a_road_without_friction_is_refused(friction: float) -> None:
    with pytest.raises(ValueError, match="friction of the road is"):
        road_of(ims(), friction)
