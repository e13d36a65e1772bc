"""Plant 1: a double-track model with more detail than the models of the controllers."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from miho.quantities import Array
from miho.vehicle.driving.compiled_tire import Tires
from miho.vehicle.driving.compiling import compiled, part
from miho.vehicle.driving.dynamics import (
    CHI,
    DELTA,
    PRESSURE,
    SIZE,
    TORQUE,
    VX,
    VY,
    WHEELS,
    Car,
    N,
    R,
    S,
    car_of,
    derivative,
    loads_of,
)
from miho.vehicle.driving.plant import Command, Motion, Plant, steps_of
from miho.vehicle.driving.powertrain import engine_speed
from miho.vehicle.driving.road import PLANE, Road, place_at, shape_at
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.models import Brake, EngineMap

LARGEST_STEP = 1e-3
"""Largest stable step [s], limited by the fastest mode, a wheel that comes to rest."""


@dataclass(frozen=True)
class FrictionSchedule:
    """Friction of a road over time, with linear changes between points.

    Parameters
    ----------
    time : tuple of float
        Times since the start of the drive [s], rising.
    friction : tuple of float
        Friction at each time, relative to the surface of the tire measurement [-]. Before the first
        time and after the last one it is constant.

    Raises
    ------
    ValueError
        If the numbers of times and frictions differ, the times do not rise, or a friction is not
        positive.

    Examples
    --------
    >>> from miho.vehicle.driving import FrictionSchedule
    >>> rain = FrictionSchedule.drop(at=12.0, share=0.3)
    >>> rain.at(11.9), round(rain.at(12.1), 3), rain.at(20.0)
    (1.0, 0.85, 0.7)
    """

    time: tuple[float, ...]
    friction: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", tuple(self.time))
        object.__setattr__(self, "friction", tuple(self.friction))
        time, friction = np.array(self.time, dtype=float), np.array(self.friction, dtype=float)
        if not time.size or time.size != friction.size:
            raise ValueError(
                f"friction has {friction.size} values for {time.size} times; expected as many"
            )
        if not (np.isfinite(time).all() and (np.diff(time) > 0).all()):
            raise ValueError(f"time is {self.time}; expected finite times that rise")
        if not (np.isfinite(friction).all() and (friction > 0).all()):
            raise ValueError(f"friction is {self.friction}; expected numbers above 0")

    @classmethod
    def drop(cls, at: float, share: float, within: float = 0.2) -> FrictionSchedule:
        """Return a friction of 1 that loses a share [-] from a time on, within a duration [s]."""
        return cls((at, at + within), (1.0, 1.0 - share))

    def at(self, time: float) -> float:
        """Return the friction at a time [s]."""
        return float(np.interp(time, self.time, self.friction))


@dataclass(frozen=True, eq=False)
class DoubleTrackState:
    """State of a `DoubleTrack`: y (23,) as in `dynamics`, and the delayed commands.

    gearbox (2,) has the engaged gear and the time until its clutch closes [s]. steering and brake
    are queues of delayed commands, one per step, the next one first. outputs (11,) are x, y [m],
    heading of the line and bank [rad] at the car, engine speed [rad/s], a_x, a_y [m/s^2] and four
    loads [N].
    """

    time: float
    y: Array
    gearbox: Array
    steering: Array
    brake: Array
    outputs: Array


@dataclass(frozen=True, eq=False)
class DoubleTrack(Plant[DoubleTrackState]):
    """Double-track car with planar motion, wheel spin, combined slip, banking, engine and brake.

    The motion is deterministic; `Sensors` adds measurement noise.

    Parameters
    ----------
    vehicle : Vehicle
        The car.
    tires : tuple of MagicFormula
        Tires front left, front right, rear left, rear right.
    engine : EngineMap
        The engine.
    brake : Brake
        The brake.
    road : Road, optional
        The road, by default a plane.
    step : float, optional
        Step of the fourth-order Runge-Kutta integration [s], at most 1e-3. Actuator delays are
        rounded to whole steps.
    friction : FrictionSchedule, optional
        Friction over time, in place of the constant friction of the road. It changes between
        calls of `advance`.

    Raises
    ------
    ValueError
        If the step or the number of tires is invalid.
    """

    vehicle: Vehicle
    tires: Tires
    engine: EngineMap
    brake: Brake
    road: Road = field(default=PLANE, repr=False)
    step: float = 1e-3
    friction: FrictionSchedule | None = None

    def __post_init__(self) -> None:
        if not 0 < self.step <= LARGEST_STEP:
            raise ValueError(
                f"step is {self.step} s; expected above 0 and at most {LARGEST_STEP:g} s"
            )
        if len(self.tires) != 4:
            raise ValueError(f"tires are {len(self.tires)}; expected 4: FL, FR, RL, RR")

    @cached_property
    def car(self) -> Car:
        """Numbers of the car for compiled code."""
        return car_of(self.vehicle, self.tires, self.engine, self.brake)

    def start(
        self, s: float = 0.0, offset: float = 0.0, speed: float = 0.0, gear: int = 1
    ) -> DoubleTrackState:
        """See `Plant.start`; the engine runs at closed throttle."""
        for name, value in (("s", s), ("offset", offset), ("speed", speed)):
            if not math.isfinite(value):
                raise ValueError(f"{name} is {value}; expected a finite number")
        Command(gear=gear).check(len(self.vehicle.gear_ratios))
        curvature, bank = shape_at(self.road, s)
        y = np.zeros(SIZE)
        y[S], y[N], y[VX] = s, offset / math.cos(bank), speed
        y[R] = curvature * math.cos(bank) * speed / (1 - offset * curvature)
        y[WHEELS : WHEELS + 2] = speed / self.vehicle.wheel_radius_front
        y[WHEELS + 2 : WHEELS + 4] = speed / self.vehicle.wheel_radius
        steering = np.zeros(round(self.vehicle.steering_delay / self.step))
        brake = np.zeros(round(self.brake.delay / self.step))
        gearbox, outputs = np.array([gear, 0.0]), np.empty(11)
        _advance(
            self.car, self.road, self.step, 0, y, gearbox, steering, brake, outputs,
            0.0, 0.0, 0.0, 0,
        )  # fmt: skip
        return DoubleTrackState(0.0, y, gearbox, steering, brake, outputs)

    def advance(
        self, state: DoubleTrackState, command: Command, duration: float
    ) -> DoubleTrackState:
        """See `Plant.advance`; the duration must be a multiple of the step."""
        count = steps_of(duration, self.step)
        command.check(len(self.vehicle.gear_ratios))
        moved = DoubleTrackState(
            state.time + duration, state.y.copy(), state.gearbox.copy(),
            state.steering.copy(), state.brake.copy(), state.outputs.copy(),
        )  # fmt: skip
        road = self.road
        if self.friction is not None:
            road = road._replace(friction=self.friction.at(state.time))
        _advance(
            self.car, road, self.step, count, moved.y, moved.gearbox, moved.steering,
            moved.brake, moved.outputs, float(command.steering), float(command.throttle),
            float(command.brake), int(command.gear),
        )  # fmt: skip
        if not np.isfinite(moved.y).all():
            raise ValueError(
                f"the motion is not finite at {moved.time:.3f} s; start with a lower speed"
            )
        return moved

    def motion(self, state: DoubleTrackState) -> Motion:
        """See `Plant.motion`."""
        y, (x, y_plan, heading, bank, engine_speed, ax, ay, *loads) = state.y, state.outputs
        chi = float(y[CHI])
        turned = math.atan2(math.sin(chi) * math.cos(bank), math.cos(chi))
        laps_of_its_own = math.tau * round((chi - turned) / math.tau)
        return Motion(
            time=state.time, x=float(x), y=float(y_plan),
            yaw=float(heading + turned + laps_of_its_own),
            vx=float(y[VX]), vy=float(y[VY]), yaw_rate=float(y[R]), ax=float(ax), ay=float(ay),
            steering=float(y[DELTA]), wheel_speeds=y[WHEELS : WHEELS + 4].copy(),
            engine_speed=float(engine_speed), engine_torque=float(y[TORQUE]),
            gear=int(state.gearbox[0]), brake_pressure=float(y[PRESSURE]), loads=np.array(loads),
        )  # fmt: skip


@compiled
def _advance(
    car: Car, road: Road, step: float, count: int, y: Array, gearbox: Array, steering: Array,
    brake: Array, outputs: Array, steering_command: float, throttle: float, brake_command: float,
    gear_command: int,
) -> None:  # fmt: skip
    """Integrate in place by fourth-order Runge-Kutta; gear and delays change between steps."""
    slope, trial, total = np.empty(y.size), np.empty(y.size), np.empty(y.size)
    for _ in range(count):
        gear, closed = _shift(car, y, gearbox, gear_command, step)
        inputs = (_delayed(steering, steering_command), throttle, _delayed(brake, brake_command))
        for j in range(y.size):
            trial[j] = total[j] = y[j]
        for stage in range(4):
            derivative(car, road, gear, closed, inputs, trial, slope)
            ahead = step if stage == 2 else step / 2
            weight = step / 3 if stage in (1, 2) else step / 6
            for j in range(y.size):
                trial[j] = y[j] + ahead * slope[j]
                total[j] += weight * slope[j]
        for j in range(y.size):
            y[j] = total[j]
    _write_outputs(car, road, int(gearbox[0]), gearbox[1] <= step / 2, y, slope, outputs)


@part
def _write_outputs(
    car: Car, road: Road, gear: int, closed: bool, y: Array, slope: Array, outputs: Array
) -> None:
    """Write `DoubleTrackState.outputs` for the state y (23,)."""
    _, bank = shape_at(road, y[S])
    outputs[0], outputs[1], outputs[2] = place_at(road, y[S], y[N] * math.cos(bank))
    outputs[3] = bank
    rear = (y[WHEELS + 2] + y[WHEELS + 3]) / 2
    outputs[4], _ = engine_speed(car.engine, car.vehicle[0], gear, closed, rear)
    outputs[5], outputs[6] = derivative(car, road, gear, closed, (0.0, 0.0, 0.0), y, slope)
    outputs[7], outputs[8], outputs[9], outputs[10] = loads_of(car, road, y)


@part
def _shift(car: Car, y: Array, gearbox: Array, gear_command: int, step: float) -> tuple[int, bool]:
    """Return the gear and whether its clutch is closed.

    A shift is ignored if the engine would exceed its largest speed.
    """
    gear = int(gearbox[0])
    if gearbox[1] > 0:
        gearbox[1] -= step
    elif gear_command != gear:
        mean = (y[WHEELS + 2] + y[WHEELS + 3]) / 2
        largest = car.vehicle[0].engine_speed_max
        if gear_command == 0 or car.engine.ratios[gear_command - 1] * mean <= largest:
            gear = gear_command
            gearbox[0], gearbox[1] = gear, car.vehicle[0].shift_time
    return gear, gearbox[1] <= step / 2


@part
def _delayed(queue: Array, command: float) -> float:
    """Return the oldest command of the queue, and append a new one."""
    if queue.size == 0:
        return command
    first: float = queue[0]
    for i in range(queue.size - 1):
        queue[i] = queue[i + 1]
    queue[queue.size - 1] = command
    return first
