"""The car that is planned for, controlled and simulated."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from miho.models.longitudinal import Longitudinal
from miho.models.single_track import SingleTrack
from miho.validate import at_least, positive

ZERO_ALLOWED = frozenset(
    ["C_d", "C_r", "C_l_front", "C_l_rear", "roll_centre_front", "roll_centre_rear",
     "unsprung_mass_front", "unsprung_mass_rear", "engine_inertia", "wheel_inertia",
     "differential_damping", "shift_time", "steering_delay"]
)  # fmt: skip
SIGNED = frozenset(("inclination_front", "inclination_rear"))


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """A car with driven rear wheels: what belongs to it and not to its tires, engine and brake.

    ISO axes: x forward, y left, z up. All in SI units and radians. The fields of `SingleTrack` and
    `Longitudinal` have their names and meaning.

    Mass and geometry. mass [kg]; lf, lr: centre of gravity to the front and rear axle [m]; Izz:
    yaw inertia [kg m^2]; h_cg: height of the centre of gravity above the ground [m]; track_front,
    track_rear [m]; wheel_radius_front and wheel_radius (of the driven rear wheels) [m].

    Air and rolling. C_d: drag [N s^2/m^2]; C_l_front, C_l_rear: downforce on each axle
    [N s^2/m^2], positive down, as a balance under the wheels measures it, so that the moment of the
    drag is in it; all three are half the air density times coefficient and area. C_r: rolling
    resistance of the car [N].

    Suspension. roll_share_front: the front axle's part of the roll stiffness [-];
    roll_centre_front, roll_centre_rear: heights of the roll centres [m]; unsprung_mass_front,
    unsprung_mass_rear: of both wheels of the axle, at the height of their hubs [kg];
    inclination_front, inclination_rear: ISO-W inclination (camber) of both wheels [rad], positive
    when the top leans to the right; load_lag: time constant with which the load follows the
    accelerations [s].

    Driveline. gear_ratios [-], gear 1 first; final_drive [-]; efficiency [-]; engine_inertia at
    engine speed and wheel_inertia of all wheels and shafts at wheel speed [kg m^2]; idle_speed and
    engine_speed_max [rad/s]; spool_rise, spool_fall: time constants of the torque when it rises
    and falls [s]; shift_time: without drive at a change of gear [s]; differential_damping: torque
    between the rear wheels per difference of their speeds [N m s], 0 for an open differential.

    Steering, at the road wheels. steering_ratio: steering wheel to road wheel [-];
    steering_delay, steering_lag (first order) [s]; steering_rate [rad/s]; steering_max [rad].

    Tires. relaxation_x, relaxation_y: relaxation lengths of the slips [m].
    """

    mass: float
    lf: float
    lr: float
    Izz: float
    h_cg: float
    track_front: float
    track_rear: float
    wheel_radius_front: float
    wheel_radius: float

    C_d: float
    C_l_front: float
    C_l_rear: float
    C_r: float

    roll_share_front: float
    roll_centre_front: float
    roll_centre_rear: float
    unsprung_mass_front: float
    unsprung_mass_rear: float
    inclination_front: float
    inclination_rear: float
    load_lag: float

    gear_ratios: tuple[float, ...]
    final_drive: float
    efficiency: float
    engine_inertia: float
    wheel_inertia: float
    idle_speed: float
    engine_speed_max: float
    spool_rise: float
    spool_fall: float
    shift_time: float
    differential_damping: float

    steering_ratio: float
    steering_delay: float
    steering_lag: float
    steering_rate: float
    steering_max: float

    relaxation_x: float
    relaxation_y: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "gear_ratios", tuple(self.gear_ratios))
        for field in fields(self):
            _check(field.name, getattr(self, field.name))
        for name in ("roll_share_front", "efficiency"):
            if getattr(self, name) > 1:
                raise ValueError(f"{name} is {getattr(self, name)}; expected at most 1")
        if self.idle_speed >= self.engine_speed_max:
            raise ValueError(
                f"idle_speed is {self.idle_speed:g} rad/s; expected below engine_speed_max, which "
                f"is {self.engine_speed_max:g} rad/s"
            )
        for axle, static in (("front", self.lr), ("rear", self.lf)):
            unsprung = getattr(self, f"unsprung_mass_{axle}")
            carried = self.mass * static / self.wheelbase
            if unsprung >= carried:
                raise ValueError(
                    f"unsprung_mass_{axle} is {unsprung:g} kg; expected less than the "
                    f"{carried:g} kg that the axle carries"
                )

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> Vehicle:
        """A vehicle from plain settings, as files of the configuration give them."""
        allowed = [field.name for field in fields(cls)]
        for name in settings:
            if name not in allowed:
                raise ValueError(f"vehicle.{name} is unknown; allowed are {', '.join(allowed)}")
        for name in allowed:
            if name not in settings:
                raise ValueError(f"vehicle.{name} is missing; give it in SI units")
        try:
            return cls(**settings)
        except ValueError as error:
            raise ValueError(f"vehicle.{error}") from None

    @property
    def wheelbase(self) -> float:
        """Front to rear axle [m]."""
        return self.lf + self.lr

    @property
    def single_track(self) -> SingleTrack:
        """Its single-track model."""
        return SingleTrack(mass=self.mass, lf=self.lf, lr=self.lr, Izz=self.Izz)

    @property
    def longitudinal(self) -> Longitudinal:
        """Its longitudinal model; the wheels' inertia acts at the radius of the driven ones."""
        names = [field.name for field in fields(Longitudinal)]
        return Longitudinal(**{name: getattr(self, name) for name in names})


def _check(name: str, value: Any) -> None:
    """Raise ValueError unless a field holds a number it can have."""
    if name == "gear_ratios":
        if not isinstance(value, tuple) or not value or not all(map(_positive, value)):
            raise ValueError(f"gear_ratios is {value!r}; give a positive ratio for each gear")
    elif not _number(value):
        raise ValueError(f"{name} is {value!r}; expected a finite number")
    elif name in ZERO_ALLOWED:
        at_least(name, value, 0)
    elif name not in SIGNED:
        positive(name, value)


def _number(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and math.isfinite(value)


def _positive(value: Any) -> bool:
    return _number(value) and value > 0
