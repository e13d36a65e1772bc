"""Parameters of a car for planning, control and simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from miho.validate import at_least, is_finite, positive
from miho.vehicle.models import Longitudinal, SingleTrack

ZERO_ALLOWED = frozenset(
    ["C_d", "C_r", "C_l_front", "C_l_rear", "roll_centre_front", "roll_centre_rear",
     "unsprung_mass_front", "unsprung_mass_rear", "engine_inertia", "wheel_inertia",
     "differential_damping", "shift_time", "steering_delay"]
)  # fmt: skip
SIGNED = frozenset(("inclination_front", "inclination_rear"))


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """Parameters of a car with driven rear wheels, without tires, engine and brake.

    ISO axes: x forward, y left, z up. All values are in SI units and radians. Fields of
    `SingleTrack` and `Longitudinal` have the same names and meaning.

    Parameters
    ----------
    mass : float
        Mass [kg].
    lf, lr : float
        Distance from the centre of gravity to the front and rear axle [m].
    Izz : float
        Yaw inertia [kg m^2].
    h_cg : float
        Height of the centre of gravity above the ground [m].
    track_front, track_rear : float
        Track widths [m].
    wheel_radius_front, wheel_radius : float
        Radii of the front wheels and of the driven rear wheels [m].
    C_d : float
        Drag [N s^2/m^2]; like C_l, half the air density times coefficient and area.
    C_l_front, C_l_rear : float
        Downforce on each axle [N s^2/m^2], positive down, as measured by a balance under the
        wheels, so that it includes the moment of the drag.
    C_r : float
        Rolling resistance of the car [N].
    roll_share_front : float
        Share of the front axle in the roll stiffness [-].
    roll_centre_front, roll_centre_rear : float
        Heights of the roll centres [m].
    unsprung_mass_front, unsprung_mass_rear : float
        Unsprung mass of both wheels of an axle, at the height of the hubs [kg].
    inclination_front, inclination_rear : float
        ISO-W inclination (camber) of both wheels [rad], positive if the top leans to the right.
    load_lag : float
        Time constant between accelerations and wheel loads [s].
    gear_ratios : tuple of float
        Gear ratios [-], gear 1 first.
    final_drive, efficiency : float
        Final drive and efficiency [-].
    engine_inertia, wheel_inertia : float
        Inertia of the engine at engine speed, and of all wheels and shafts at wheel speed [kg m^2].
    idle_speed, engine_speed_max : float
        Smallest and largest engine speed [rad/s].
    spool_rise, spool_fall : float
        Time constants of rising and falling torque [s].
    shift_time : float
        Time without drive in a shift [s].
    differential_damping : float
        Torque between the rear wheels per difference of their speeds [N m s], 0 for an open
        differential.
    steering_ratio : float
        Angle of the steering wheel per angle of the road wheels [-].
    steering_delay, steering_lag : float
        Dead time and first-order time constant of the road wheels [s].
    steering_rate, steering_max : float
        Largest rate [rad/s] and angle [rad] of the road wheels.
    relaxation_x, relaxation_y : float
        Relaxation lengths of the slips [m].

    Raises
    ------
    ValueError
        If a value is out of range.
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
        """Make a vehicle from plain settings of a configuration."""
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
        """Distance between the axles [m]."""
        return self.lf + self.lr

    @property
    def single_track(self) -> SingleTrack:
        """Single-track model of the car."""
        return SingleTrack(mass=self.mass, lf=self.lf, lr=self.lr, Izz=self.Izz)

    @property
    def longitudinal(self) -> Longitudinal:
        """Longitudinal model; the inertia of all wheels acts at the radius of the driven wheels."""
        names = [field.name for field in fields(Longitudinal)]
        return Longitudinal(**{name: getattr(self, name) for name in names})


def _check(name: str, value: Any) -> None:
    """Raise ValueError unless the value of a field is valid."""
    if name == "gear_ratios":
        ratios = value if isinstance(value, tuple) else ()
        if not ratios or not all(is_finite(ratio) and ratio > 0 for ratio in ratios):
            raise ValueError(f"gear_ratios is {value!r}; give a positive ratio for each gear")
    elif not is_finite(value):
        raise ValueError(f"{name} is {value!r}; expected a finite number")
    elif name in ZERO_ALLOWED:
        at_least(name, value, 0)
    elif name not in SIGNED:
        positive(name, value)
