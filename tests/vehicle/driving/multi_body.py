"""A second plant for tests: the multi-body model of CommonRoad, an independent implementation.

The model has 29 states: a sprung body on two axles with roll and heave, compliant joints, and a
Magic Formula (Althoff, Koschi and Manzinger, CommonRoad: Composable benchmarks, IV 2017; after
Allen et al., DOT HS 807 700, 1992). Its tires have no load sensitivity, and it has no downforce,
banking or engine. It therefore tests the path tracker, not planning with load transfer. It needs
the package commonroad-vehicle-models (extra crosscheck).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import numpy as np

from miho.quantities import Array
from miho.vehicle.driving.plant import Command, Motion, Plant, steps_of
from miho.vehicle.driving.powertrain import engine_of, map_torque
from miho.vehicle.driving.road import PLANE, Road, place_at
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.models.axle import Axle
from miho.vehicle.models.brake import Brake
from miho.vehicle.models.engine_map import EngineMap

BMW = 2
"""CommonRoad's number of its car, a BMW 320i."""
STEP = 1e-3
"""Step of the fourth-order Runge-Kutta integration [s]."""
GRAVITY = 9.81
"""Gravity of the model [m/s^2]."""


@dataclass(frozen=True, eq=False)
class MultiBodyState:
    """State of a `MultiBody`: 29 states x, delayed steering commands, and a_x, a_y [m/s^2]."""

    time: float
    x: tuple[float, ...]
    steering: tuple[float, ...]
    gear: int
    throttle: float
    brake: float
    felt: tuple[float, float]


@dataclass(frozen=True, eq=False)
class MultiBody(Plant[MultiBodyState]):
    """A car of CommonRoad on flat ground, with the actuators of `vehicle`.

    The inputs of the model are a steering rate and an acceleration. Steering has the delay, lag
    and rate of `vehicle`. Throttle, gear and brake act without delay, by the driveline, brake and
    drag of `vehicle` on the mass of the model. The model limits the acceleration (11.5 m/s^2, and
    less above 7.3 m/s when driving). Controllers use `own_vehicle` and `axles`. The bank of the
    road has no effect; its friction scales the peaks of the tires.
    """

    vehicle: Vehicle
    engine: EngineMap
    brake: Brake
    road: Road = field(default=PLANE, repr=False)

    @cached_property
    def parameters(self) -> Any:
        """Parameters of the model, in SI units with the names of CommonRoad."""
        module = import_module("vehiclemodels.vehicle_parameters")
        return _plain(module.setup_vehicle_parameters(vehicle_id=BMW))

    @cached_property
    def _on_road(self) -> Any:
        """`parameters` with the friction of the road; the model has no LMUX and LMUY."""
        p, friction = self.parameters, self.road.friction
        peaks = {name: friction * getattr(p.tire, name) for name in ("p_dx1", "p_dy1")}
        return SimpleNamespace(**vars(p) | {"tire": SimpleNamespace(**vars(p.tire) | peaks)})

    @property
    def own_vehicle(self) -> Vehicle:
        """`vehicle` with the model's mass, geometry and yaw inertia, and without downforce."""
        p = self.parameters
        return replace(
            self.vehicle, mass=p.m, lf=p.a, lr=p.b, Izz=p.I_z, h_cg=p.h_cg,
            track_front=p.T_f, track_rear=p.T_r, C_l_front=0.0, C_l_rear=0.0,
            unsprung_mass_front=p.m_uf, unsprung_mass_rear=p.m_ur, roll_centre_front=p.h_raf,
            roll_centre_rear=p.h_rar, inclination_front=0.0, inclination_rear=0.0,
        )  # fmt: skip

    @property
    def axles(self) -> tuple[Axle, Axle]:
        """Front and rear axle at rest, from the model's lateral tire formula; ISO-W.

        D and the stiffness are proportional to the load, and shifts vanish without camber.
        """
        p, tire = self.parameters, self.parameters.tire
        curves = []
        for arm in (p.b, p.a):
            D = tire.p_dy1 * p.m * GRAVITY * arm / (p.a + p.b) / 2
            B = abs(tire.p_ky1) / (tire.p_cy1 * tire.p_dy1)
            curves.append(np.array([B, tire.p_cy1, D, tire.p_ey1, 0.0, 0.0]))
        return Axle(curves[0], curves[0]), Axle(curves[1], curves[1])

    def start(
        self, s: float = 0.0, offset: float = 0.0, speed: float = 0.0, gear: int = 1
    ) -> MultiBodyState:
        """See `Plant.start`."""
        Command(gear=gear).check(len(self.vehicle.gear_ratios))
        x, y, heading = place_at(self.road, s, offset)
        init = import_module("vehiclemodels.init_mb").init_mb
        at = init([x, y, 0.0, speed, heading, 0.0, 0.0], self.parameters)
        waiting = (0.0,) * round(self.vehicle.steering_delay / STEP)
        return MultiBodyState(0.0, tuple(map(float, at)), waiting, gear, 0.0, 0.0, (0.0, 0.0))

    def advance(self, state: MultiBodyState, command: Command, duration: float) -> MultiBodyState:
        """See `Plant.advance`; the model divides by zero in a spin."""
        count = steps_of(duration, STEP)
        command.check(len(self.vehicle.gear_ratios))
        x, waiting, slope = np.array(state.x), list(state.steering), np.zeros(len(state.x))
        pull = self._pull(command)
        for _ in range(count):
            waiting.append(command.steering)
            inputs = waiting.pop(0), pull(float(x[3]))
            k1 = slope = self._slope(x, *inputs)
            k2 = self._slope(x + STEP / 2 * k1, *inputs)
            k3 = self._slope(x + STEP / 2 * k2, *inputs)
            k4 = self._slope(x + STEP * k3, *inputs)
            x = x + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            x[23:27] = np.maximum(x[23:27], 0.0)
        felt = float(slope[3] - x[5] * x[10]), float(slope[10] + x[5] * x[3])
        return MultiBodyState(
            state.time + duration, tuple(x.tolist()), tuple(waiting), int(command.gear),
            float(command.throttle), float(command.brake), felt,
        )  # fmt: skip

    def motion(self, state: MultiBodyState) -> Motion:
        """See `Plant.motion`; wheel loads are forces of the tires' vertical springs.

        The model's left wheels are the outer wheels of a left turn, which are right wheels here.
        """
        x, p = state.x, self.parameters
        omega = self._engine_speed(x[3], state.gear)
        loads = []
        for heave, roll, track in ((x[16], x[13], p.T_f), (x[21], x[18], p.T_r)):
            middle = heave + p.R_w * (math.cos(roll) - 1)
            loads += [(middle + side * track / 2 * math.sin(roll)) * p.K_zt for side in (1, -1)]
        return Motion(
            time=state.time, x=x[0], y=x[1], yaw=x[4], vx=x[3], vy=x[10], yaw_rate=x[5],
            ax=state.felt[0], ay=state.felt[1], steering=x[2],
            wheel_speeds=np.array([x[24], x[23], x[26], x[25]]),
            engine_speed=omega, engine_torque=float(self.engine.torque(omega, state.throttle)),
            gear=state.gear, brake_pressure=state.brake, loads=np.array(loads),
        )  # fmt: skip

    def _slope(self, x: Array, steering: float, acceleration: float) -> Array:
        v = self.vehicle
        steering = min(max(steering, -v.steering_max), v.steering_max)
        rate = min(max((steering - x[2]) / v.steering_lag, -v.steering_rate), v.steering_rate)
        return np.array(self._model(x.tolist(), [rate, acceleration], self._on_road))

    @cached_property
    def _model(self) -> Any:
        return import_module("vehiclemodels.vehicle_dynamics_mb").vehicle_dynamics_mb

    def _engine_speed(self, vx: float, gear: int) -> float:
        v = self.vehicle
        ratio = v.gear_ratios[gear - 1] * v.final_drive if gear > 0 else 0.0
        return max(vx * ratio / v.wheel_radius, v.idle_speed)

    def _pull(self, command: Command) -> Callable[[float], float]:
        """Return the acceleration [m/s^2] of a command as a function of the speed [m/s]."""
        v, gear = self.vehicle, int(command.gear)
        braking = float(self.brake.force_of_pressure(command.brake)) + v.C_r
        inertia, lever = float(self.parameters.m), 0.0
        if gear > 0:
            inertia += float(v.longitudinal.equivalent_mass(gear))
            lever = v.gear_ratios[gear - 1] * v.final_drive / v.wheel_radius
        engine = engine_of(v, self.engine)

        def acceleration(vx: float) -> float:
            force = -(braking + v.C_d * vx**2) if vx > 0 else 0.0
            omega = self._engine_speed(vx, gear)
            torque = map_torque(engine, omega, command.throttle)
            force += lever * torque * (v.efficiency if torque >= 0 else 1 / v.efficiency)
            return force / inertia

        return acceleration


def _plain(node: Any) -> Any:
    """Return settings as plain objects, because access to the library's objects is slow."""
    if not isinstance(node, Mapping):
        return node
    return SimpleNamespace(**{str(name): _plain(value) for name, value in node.items()})
