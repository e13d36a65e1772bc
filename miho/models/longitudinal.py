"""Longitudinal dynamics of a car in gear: Eq. 6-7 with grade and rotating mass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from miho.quantities import Array, g
from miho.validate import positive_settings, settings_at_least


@dataclass(frozen=True, kw_only=True)
class Longitudinal:
    """A car driving forward in a gear, clutch closed and tires rolling without slip.

        engine (T_e, I_e) -> gears (i = i_g i_0, eta) -> wheels (F_w, I_w, R) -> road

        (m + I_w / R^2) a = F_w - C_d v^2 - C_r - m g sin(grade)        at the wheels (Eq. 6)
        F_w = eta^s (T_e - I_e i a / R) i / R                           through the gears (Eq. 7)

    The engine's own inertia takes its torque before the gears, so no loss applies to it; the
    wheels' takes its torque after them. The loss lies against the flow of power: s = 1 when the
    gears drive the wheels (F_w > 0) and s = -1 when the wheels drag the engine along (F_w < 0),
    where part of the engine's braking is spared by the friction of the gears. As printed, Eq. 6-7
    are the case of no inertia, no grade and F_w > 0.

    mass: m [kg]. wheel_radius: R of the driven wheels [m]. gear_ratios: i_g [-], gear 1 first.
    final_drive: i_0 [-]. efficiency: eta [-] in (0, 1]. engine_inertia: I_e at engine speed
    [kg m^2]. wheel_inertia: I_w of all wheels and shafts at wheel speed [kg m^2]. C_d: drag
    [N s^2/m^2]. C_r: rolling resistance [N]. Brakes are no part of it.

    In the methods ax [m/s^2] is the derivative of the speed vx [m/s] along the road, gear a whole
    number from 1, and grade [rad] positive uphill; they broadcast. Torques are of the engine [Nm].
    """

    mass: float
    wheel_radius: float
    gear_ratios: tuple[float, ...]
    final_drive: float
    efficiency: float
    engine_inertia: float
    wheel_inertia: float
    C_d: float
    C_r: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "gear_ratios", tuple(self.gear_ratios))
        if not self.gear_ratios or not all(0 < ratio < np.inf for ratio in self.gear_ratios):
            raise ValueError(
                f"gear_ratios is {self.gear_ratios}; give a positive ratio for each gear"
            )
        positive_settings(self, ("mass", "wheel_radius", "final_drive"))
        settings_at_least(self, ("engine_inertia", "wheel_inertia", "C_d", "C_r"), 0)
        if not 0 < self.efficiency <= 1:
            raise ValueError(
                f"efficiency is {self.efficiency}; expected a number above 0 and at most 1"
            )

    def ratio(self, gear: ArrayLike) -> Array:
        """Turns of the engine per turn of the wheel, i = i_g i_0 [-]."""
        gear = np.asarray(gear, dtype=float)
        valid = np.isin(gear, np.arange(1, len(self.gear_ratios) + 1))
        if not valid.all():
            wrong = gear[~valid].flat[0]
            raise ValueError(
                f"gear {wrong:g} does not exist; expected 1 to {len(self.gear_ratios)}"
            )
        return np.asarray(np.asarray(self.gear_ratios)[gear.astype(int) - 1] * self.final_drive)

    def equivalent_mass(self, gear: ArrayLike) -> Array:
        """The mass that is equivalent to all rotating parts [kg]: (I_e i^2 + I_w) / R^2."""
        inertia = self.engine_inertia * self.ratio(gear) ** 2 + self.wheel_inertia
        return np.asarray(inertia / self.wheel_radius**2)

    def traction_force(
        self, ax: ArrayLike, vx: ArrayLike, gear: ArrayLike, grade: ArrayLike = 0.0
    ) -> Array:
        """F_x,r [N] that the whole engine torque gives at the wheels, eta^s T_e i / R (Eq. 6).

        It moves the car and all that turns; the force between tire and road is less by what
        turns engine and wheels faster.
        """
        loss = self._loss(self._wheel_force(ax, vx, grade))
        ratio = self.ratio(gear)
        engine = self.engine_inertia * (ratio / self.wheel_radius) ** 2 * np.asarray(ax)
        return np.asarray(self._wheel_force(ax, vx, grade) + loss * engine)

    def engine_torque(
        self, ax: ArrayLike, vx: ArrayLike, gear: ArrayLike, grade: ArrayLike = 0.0
    ) -> Array:
        """T_e [Nm] of the engine, with what accelerates the engine itself (Eq. 7 inverted)."""
        loss = self._loss(self._wheel_force(ax, vx, grade))
        force = self.traction_force(ax, vx, gear, grade)
        return np.asarray(force * self.wheel_radius / (loss * self.ratio(gear)))

    def acceleration(
        self, torque: ArrayLike, vx: ArrayLike, gear: ArrayLike, grade: ArrayLike = 0.0
    ) -> Array:
        """ax [m/s^2] that an engine torque gives: the exact inverse of `engine_torque`."""
        resistance = self._wheel_force(0.0, vx, grade)
        rolling_mass = self.mass + self.wheel_inertia / self.wheel_radius**2
        lever = self.ratio(gear) / self.wheel_radius
        # The gears carry nothing when the car slows down as fast as one without an engine.
        idle = -self.engine_inertia * lever * resistance / rolling_mass
        loss = self._loss(np.asarray(torque) - idle)
        inertia = rolling_mass + loss * self.engine_inertia * lever**2
        return np.asarray((loss * lever * np.asarray(torque) - resistance) / inertia)

    def engine_speed(self, vx: ArrayLike, gear: ArrayLike) -> Array:
        """Engine speed [rad/s] that belongs to a speed in a gear."""
        return np.asarray(np.asarray(vx) * self.ratio(gear) / self.wheel_radius)

    def _wheel_force(self, ax: ArrayLike, vx: ArrayLike, grade: ArrayLike) -> Array:
        """F_w [N], through the gears to the wheels."""
        ax, vx = np.asarray(ax, dtype=float), np.asarray(vx, dtype=float)
        rolling_mass = self.mass + self.wheel_inertia / self.wheel_radius**2
        resistance = self.C_d * vx**2 + self.C_r + self.mass * g * np.sin(grade)
        return np.asarray(rolling_mass * ax + resistance)

    def _loss(self, flow: Array) -> Array:
        """eta^s: the efficiency towards the wheels, its inverse towards the engine."""
        return np.where(flow >= 0, self.efficiency, 1 / self.efficiency)
