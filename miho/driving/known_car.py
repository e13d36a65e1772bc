"""What planner and controllers know of a car: the identified models, in one place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miho.driving.grip import Grip
from miho.driving.load_transfer import LoadTransfer
from miho.driving.path_tracking import (
    GainSchedule,
    LateralModel,
    SampledModel,
    SteeringActuator,
    Weights,
)
from miho.driving.plant_parameters import Tires
from miho.driving.speed_control import SpeedController, SpeedSettings
from miho.driving.steering_control import AxleSlip, SteeringController
from miho.driving.vehicle import Vehicle
from miho.driving.velocity_planner import VelocityPlanner
from miho.models.axle import Axle
from miho.models.brake import Brake
from miho.models.engine_map import EngineMap
from miho.models.simplified_tire import simplify
from miho.quantities import Array


@dataclass(frozen=True, eq=False)
class KnownCar:
    """A vehicle with its tires, engine and brake as they are known, right or wrong.

    front, rear: the axles' curves, at loads [N] (4,) of the wheels: front left, front right, rear
    left, rear right. grip: the tires' largest forces.
    """

    vehicle: Vehicle
    front: Axle
    rear: Axle
    loads: Array
    grip: Grip
    engine: EngineMap
    brake: Brake

    @classmethod
    def of_tires(cls, vehicle: Vehicle, tires: Tires, engine: EngineMap, brake: Brake) -> KnownCar:
        """What there is to know of a car with these full tires: front left, right, rear likewise.

        The curves have the tires' parameters at static load and inclination, not fitted ones.
        """
        loads, lean = static_loads(vehicle), inclinations(vehicle)
        curves = []
        for tire, load, gamma in zip(tires, loads, lean, strict=True):
            simple = simplify(tire, float(load), float(gamma))
            names = ("B", "C", "D", "E", "Sx", "Sy")
            curves.append(np.array([getattr(simple, name)[0] for name in names]))
        front, rear = Axle(curves[0], curves[1]), Axle(curves[2], curves[3])
        grip = Grip.of_tires(tires, loads, lean)
        return cls(vehicle, front, rear, loads, grip, engine, brake)

    def planner(self, mu: float = 1.0, top_speed: float = 90.0) -> VelocityPlanner:
        """The velocity planner for this car."""
        return VelocityPlanner(self.vehicle, self.grip, self.engine, self.brake, mu, top_speed)

    def speed_controller(self, settings: SpeedSettings | None = None) -> SpeedController:
        """The throttle and brake controller."""
        settings = SpeedSettings() if settings is None else settings
        return SpeedController(self.vehicle, self.engine, self.brake, settings)

    def steering_controller(self, weights: Weights, period: float = 0.01) -> SteeringController:
        """The path tracker, with a command every `period` [s]."""
        car = self.vehicle
        lateral = LateralModel(
            car=car.single_track,
            C_f=self.front.cornering_stiffness,
            C_r=self.rear.cornering_stiffness,
        )
        actuator = SteeringActuator(delay=car.steering_delay, lag=car.steering_lag)
        sampled = SampledModel(model=lateral, steering=actuator, period=period)
        return SteeringController(
            car,
            GainSchedule.of(sampled, weights),
            AxleSlip.of(self.front, float(self.loads[:2].sum())),
            AxleSlip.of(self.rear, float(self.loads[2:].sum())),
        )


def static_loads(vehicle: Vehicle) -> Array:
    """Loads of the wheels of a car at rest [N], (4,): front left, front right, rear likewise."""
    return np.array([float(load) for load in LoadTransfer(vehicle).wheel_loads(0.0)])


def inclinations(vehicle: Vehicle) -> Array:
    """ISO-W inclinations of the wheels [rad], (4,), in the same order."""
    return np.repeat([vehicle.inclination_front, vehicle.inclination_rear], 2)
