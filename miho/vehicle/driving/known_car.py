"""The identified models of a car, for planner and controllers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miho.quantities import Array
from miho.vehicle.driving.compiled_tire import Tires
from miho.vehicle.driving.grip import LOADS, Grip
from miho.vehicle.driving.load_transfer import LoadTransfer
from miho.vehicle.driving.loaded_axle import LoadedAxle
from miho.vehicle.driving.path_tracking import (
    SPEEDS,
    ErrorEstimator,
    GainSchedule,
    LateralModel,
    SampledModel,
    SteeringActuator,
    Weights,
)
from miho.vehicle.driving.plant import Sensors
from miho.vehicle.driving.speed_control import SpeedController, SpeedSettings
from miho.vehicle.driving.steering_control import AxleSlip, SteeringController
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.driving.velocity_planner import VelocityPlanner
from miho.vehicle.models import Axle, Brake, EngineMap, LoadSensitivity, simplify
from miho.vehicle.models.magic_formula import MagicFormula


@dataclass(frozen=True, eq=False)
class KnownCar:
    """A vehicle with identified tires, engine and brake, which may differ from the true car.

    Parameters
    ----------
    vehicle : Vehicle
        The car.
    front, rear : Axle
        Curves of the axles at `loads`.
    loads : ndarray of shape (4,)
        Loads of the wheels [N]: front left, front right, rear left, rear right.
    grip : Grip
        Largest forces of the tires at `loads`.
    engine : EngineMap
        The engine.
    brake : Brake
        The brake.
    stiffness_sensitivity : ndarray of shape (4,), optional
        q_K of `LoadSensitivity` at `loads` [-]. By default the sensitivity of the largest forces,
        so that curves keep their shape.
    """

    vehicle: Vehicle
    front: Axle
    rear: Axle
    loads: Array
    grip: Grip
    engine: EngineMap
    brake: Brake
    stiffness_sensitivity: Array | None = None

    @classmethod
    def of_tires(cls, vehicle: Vehicle, tires: Tires, engine: EngineMap, brake: Brake) -> KnownCar:
        """Return the known car for exact full tires: front left, front right, rear left and right.

        The curves follow from the tires at static load and inclination, without a fit.
        """
        loads, lean = static_loads(vehicle), inclinations(vehicle)
        curves = []
        for tire, load, gamma in zip(tires, loads, lean, strict=True):
            simple = simplify(tire, float(load), float(gamma))
            names = ("B", "C", "D", "E", "Sx", "Sy")
            curves.append(np.array([getattr(simple, name)[0] for name in names]))
        front, rear = Axle(curves[0], curves[1]), Axle(curves[2], curves[3])
        grip = Grip.of_tires(tires, loads, lean)
        stiffness = [_stiffness_sensitivity(*of) for of in zip(tires, loads, lean, strict=True)]
        return cls(vehicle, front, rear, loads, grip, engine, brake, np.array(stiffness))

    @property
    def loaded_axles(self) -> tuple[LoadedAxle, LoadedAxle]:
        """Front and rear axle with the loads of their curves."""
        peak = self.grip.lateral_sensitivity
        stiffness = peak if self.stiffness_sensitivity is None else self.stiffness_sensitivity
        front, rear = (
            LoadedAxle(axle, self.loads[part], LoadSensitivity(peak[part], stiffness[part]))
            for axle, part in ((self.front, slice(0, 2)), (self.rear, slice(2, 4)))
        )
        return front, rear

    def axles(self, vx: float) -> tuple[Axle, Axle]:
        """Return both axles at the loads of straight driving at a speed [m/s] on a plane."""
        loads = straight_loads(self.vehicle, vx)
        front, rear = self.loaded_axles
        return front.at(loads[:2]), rear.at(loads[2:])

    def planner(self, mu: float = 1.0, top_speed: float = 90.0) -> VelocityPlanner:
        """Return the velocity planner for this car."""
        return VelocityPlanner(self.vehicle, self.grip, self.engine, self.brake, mu, top_speed)

    def speed_controller(self, settings: SpeedSettings | None = None) -> SpeedController:
        """Return the throttle and brake controller."""
        settings = SpeedSettings() if settings is None else settings
        return SpeedController(self.vehicle, self.engine, self.brake, settings)

    def steering_controller(self, weights: Weights, period: float = 0.01) -> SteeringController:
        """Return the path tracker for the noise of `Sensors`, with a command every `period` [s]."""
        car = self.vehicle
        axles = [self.axles(float(vx)) for vx in SPEEDS]
        lateral = LateralModel(
            car=car.single_track,
            C_f=np.array([front.cornering_stiffness for front, _ in axles]),
            C_r=np.array([rear.cornering_stiffness for _, rear in axles]),
            speeds=SPEEDS,
        )
        actuator = SteeringActuator(delay=car.steering_delay, lag=car.steering_lag)
        sampled = SampledModel(model=lateral, steering=actuator, period=period)
        front, rear = self.loaded_axles
        loads = static_loads(car)
        schedule = GainSchedule.of(sampled, weights)
        front_slip, rear_slip = _axle_slip(front, loads[:2]), _axle_slip(rear, loads[2:])
        estimator = ErrorEstimator.of(sampled, Sensors(), schedule.speeds)
        return SteeringController(car, schedule, front_slip, rear_slip, estimator)


def straight_loads(vehicle: Vehicle, vx: float) -> Array:
    """Return the loads of the wheels [N], (4,), at a constant speed [m/s] straight ahead."""
    return np.array(LoadTransfer(vehicle).wheel_loads(vx))


def static_loads(vehicle: Vehicle) -> Array:
    """Return the loads of the wheels at rest [N], (4,): front left, front right, rear likewise."""
    return straight_loads(vehicle, 0.0)


def inclinations(vehicle: Vehicle) -> Array:
    """Return the ISO-W inclinations of the wheels [rad], (4,), in the same order."""
    return np.repeat([vehicle.inclination_front, vehicle.inclination_rear], 2)


def _axle_slip(axle: LoadedAxle, loads: Array) -> AxleSlip:
    """Return the slip of an axle at loads (2,) [N], with the mean of its sensitivities."""
    peak, stiffness = axle.sensitivity.at_load(loads / axle.loads)
    mean = LoadSensitivity(float(np.mean(peak)), float(np.mean(stiffness)))
    return AxleSlip.of(axle.at(loads), float(loads.sum()), mean)


def _stiffness_sensitivity(tire: MagicFormula, load: float, inclination: float) -> float:
    """Return q_K of a full tire at a load [N], fitted between 0.4 and 1.9 times the load."""
    x = np.array(LOADS)
    curve = simplify(tire, load * x, inclination)
    slope, level = np.polyfit(x * x - 1, x / (curve.B * curve.C * curve.D), 1)
    return float(-2 * slope / level)
