"""Longitudinal dynamics of a car in gear: Eq. 6-7 with grade and rotating mass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from miho.quantities import Array, g
from miho.validate import positive_settings, settings_at_least


@dataclass(frozen=True, kw_only=True)
class Longitudinal:
    """Longitudinal motion of a car in a gear, with closed clutch and without slip of the tires.

        engine (T_e, I_e) -> gears (i = i_g i_0, eta) -> wheels (F_w, I_w, R) -> road

        (m + I_w / R^2) a = F_w - C_d v^2 - C_r - m g sin(grade)        at the wheels (Eq. 6)
        F_w = eta^s (T_e - I_e i a / R) i / R                           through the gears (Eq. 7)

    Torque for the inertia of the engine is taken before the gears, without loss; torque for the
    inertia of the wheels is taken after them. The loss acts against the flow of power: s = 1 if
    the gears drive the wheels (F_w > 0), and s = -1 if the wheels drive the engine (F_w < 0), so
    that friction of the gears adds to the braking of the engine. Eq. 6-7 as printed are the case
    without inertia and grade and with F_w > 0. Brakes are not part of the model.

    In all methods, ax [m/s^2] is the derivative of the speed vx [m/s] along the road, gear is a
    whole number from 1, and grade [rad] is positive uphill; arguments broadcast. Torques are
    engine torques [Nm].

    Parameters
    ----------
    mass : float
        m [kg].
    wheel_radius : float
        R of the driven wheels [m].
    gear_ratios : tuple of float
        i_g [-], gear 1 first.
    final_drive : float
        i_0 [-].
    efficiency : float
        eta [-], above 0 and at most 1.
    engine_inertia : float
        I_e at engine speed [kg m^2].
    wheel_inertia : float
        I_w of all wheels and shafts at wheel speed [kg m^2].
    C_d : float
        Drag [N s^2/m^2].
    C_r : float
        Rolling resistance [N].

    Raises
    ------
    ValueError
        If a parameter is out of range.
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
        """Return the turns of the engine per turn of the wheel, i = i_g i_0 [-]."""
        gear = np.asarray(gear, dtype=float)
        valid = np.isin(gear, np.arange(1, len(self.gear_ratios) + 1))
        if not valid.all():
            wrong = gear[~valid].flat[0]
            raise ValueError(
                f"gear {wrong:g} does not exist; expected 1 to {len(self.gear_ratios)}"
            )
        return np.asarray(np.asarray(self.gear_ratios)[gear.astype(int) - 1] * self.final_drive)

    def equivalent_mass(self, gear: ArrayLike) -> Array:
        """Return the equivalent mass of all rotating parts, (I_e i^2 + I_w) / R^2 [kg]."""
        inertia = self.engine_inertia * self.ratio(gear) ** 2 + self.wheel_inertia
        return np.asarray(inertia / self.wheel_radius**2)

    def traction_force(
        self, ax: ArrayLike, vx: ArrayLike, gear: ArrayLike, grade: ArrayLike = 0.0
    ) -> Array:
        """Return F_x,r [N], the force of the engine torque at the wheels, eta^s T_e i / R (Eq. 6).

        The force accelerates the car and all rotating parts. The force between tire and road is
        smaller by the part that accelerates the engine and the wheels.
        """
        loss = self._loss(self._wheel_force(ax, vx, grade))
        ratio = self.ratio(gear)
        engine = self.engine_inertia * (ratio / self.wheel_radius) ** 2 * np.asarray(ax)
        return np.asarray(self._wheel_force(ax, vx, grade) + loss * engine)

    def engine_torque(
        self, ax: ArrayLike, vx: ArrayLike, gear: ArrayLike, grade: ArrayLike = 0.0
    ) -> Array:
        """Return T_e [Nm], with the torque that accelerates the engine (Eq. 7 inverted)."""
        loss = self._loss(self._wheel_force(ax, vx, grade))
        force = self.traction_force(ax, vx, gear, grade)
        return np.asarray(force * self.wheel_radius / (loss * self.ratio(gear)))

    def acceleration(
        self, torque: ArrayLike, vx: ArrayLike, gear: ArrayLike, grade: ArrayLike = 0.0
    ) -> Array:
        """Return ax [m/s^2] for an engine torque, the exact inverse of `engine_torque`."""
        resistance = self._wheel_force(0.0, vx, grade)
        rolling_mass = self.mass + self.wheel_inertia / self.wheel_radius**2
        lever = self.ratio(gear) / self.wheel_radius
        # At this torque, no power flows through the gears: the car slows as without an engine.
        idle = -self.engine_inertia * lever * resistance / rolling_mass
        loss = self._loss(np.asarray(torque) - idle)
        inertia = rolling_mass + loss * self.engine_inertia * lever**2
        return np.asarray((loss * lever * np.asarray(torque) - resistance) / inertia)

    def engine_speed(self, vx: ArrayLike, gear: ArrayLike) -> Array:
        """Return the engine speed [rad/s] at a speed in a gear."""
        return np.asarray(np.asarray(vx) * self.ratio(gear) / self.wheel_radius)

    def _wheel_force(self, ax: ArrayLike, vx: ArrayLike, grade: ArrayLike) -> Array:
        """Return F_w [N], the force from the gears to the wheels."""
        ax, vx = np.asarray(ax, dtype=float), np.asarray(vx, dtype=float)
        rolling_mass = self.mass + self.wheel_inertia / self.wheel_radius**2
        resistance = self.C_d * vx**2 + self.C_r + self.mass * g * np.sin(grade)
        return np.asarray(rolling_mass * ax + resistance)

    def _loss(self, flow: Array) -> Array:
        """Return eta^s: the efficiency towards the wheels, or its inverse towards the engine."""
        return np.where(flow >= 0, self.efficiency, 1 / self.efficiency)
