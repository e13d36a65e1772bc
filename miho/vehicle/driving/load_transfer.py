"""Quasi-static loads of the four wheels in a manoeuvre (Sec. IV-A).

The lateral load transfer of an axle has three parts (Milliken and Milliken, Race Car Vehicle
Dynamics, 1995, Ch. 18; Seward, Race Car Design, 2017, Ch. 5):

    elastic    lambda m_s a_y h_a / t      through springs and bars, split by roll stiffness
    geometric  m_s,axle a_y z / t          through the suspension's links, at the roll centre
    unsprung   m_u a_y R / t               of the unsprung masses

with the sprung mass m_s, its height h_a above the roll axis, roll-centre height z, track t and
wheel radius R. Together they balance the moment m a_y h of the whole car. The small shift of the
centre of gravity in roll is neglected.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from miho.quantities import Array, g
from miho.vehicle.driving.compiling import part
from miho.vehicle.driving.vehicle import Vehicle


class WheelLoads(NamedTuple):
    """Vertical loads of the wheels.

    Attributes
    ----------
    front_left, front_right, rear_left, rear_right : ndarray
        Load of each wheel [N], at least 0.
    """

    front_left: Array
    front_right: Array
    rear_left: Array
    rear_right: Array


class LateralTransfer(NamedTuple):
    """Load that an axle moves from the left to the right wheel per lateral acceleration [kg]."""

    elastic: float
    geometric: float
    unsprung: float


class LoadCoefficients(NamedTuple):
    """Coefficients of the loads: masses [kg] and downforce [N s^2/m^2]."""

    mass_front: float  # carried by the axle at rest
    mass_rear: float
    C_l_front: float
    C_l_rear: float
    longitudinal: float  # from the front to the rear axle per a_x
    lateral_front: float  # from the left to the right wheel per a_y
    lateral_rear: float


@dataclass(frozen=True)
class LoadTransfer:
    """Loads of a vehicle's wheels.

    Parameters
    ----------
    vehicle : Vehicle
        The car.
    as_printed : bool, optional
        Use the printed equation: the roll couple m_s v_y' h_a only, with the rate of the lateral
        velocity, which is zero in steady cornering, without longitudinal transfer and downforce.
    """

    vehicle: Vehicle
    as_printed: bool = False

    def wheel_loads(
        self,
        vx: ArrayLike,
        ax: ArrayLike = 0.0,
        ay: ArrayLike = 0.0,
        vy_rate: ArrayLike = 0.0,
        gravity: ArrayLike = g,
    ) -> WheelLoads:
        """Return the loads for inputs that broadcast.

        If a wheel lifts, it carries 0 and the other wheel of the axle carries all; an axle that
        lifts carries 0.

        Parameters
        ----------
        vx : array_like
            Speed [m/s].
        ax, ay : array_like, optional
            Forces other than weight, per mass [m/s^2], as measured by an accelerometer. On a flat
            road, ay is v_y' + v_x r; on a bank, it is smaller by g sin(bank).
        vy_rate : array_like, optional
            v_y' [m/s^2], used only with `as_printed`.
        gravity : array_like, optional
            Acceleration that presses the car on the road [m/s^2]; on a bank
            g cos(bank) + v^2 kappa sin(bank), with the curvature kappa in the plan.

        Returns
        -------
        WheelLoads
            Loads [N], at least 0.
        """
        vx, ax, ay, vy_rate, gravity = np.broadcast_arrays(
            *(np.asarray(value, dtype=float) for value in (vx, ax, ay, vy_rate, gravity))
        )
        lateral = vy_rate if self.as_printed else ay
        return WheelLoads(*wheel_loads(self.coefficients, vx, ax, lateral, gravity))

    @property
    def lateral_parts(self) -> tuple[LateralTransfer, LateralTransfer]:
        """Parts of the lateral transfer, front and rear axle."""
        car = self.vehicle
        unsprung = car.unsprung_mass_front, car.unsprung_mass_rear
        radii = car.wheel_radius_front, car.wheel_radius
        sprung = [m - u for m, u in zip(self._carried, unsprung, strict=True)]
        centres = car.roll_centre_front, car.roll_centre_rear
        moments = [m * z for m, z in zip(sprung, centres, strict=True)]
        hubs = [m * r for m, r in zip(unsprung, radii, strict=True)]
        # m_s h_a is the rest of the total moment, which the three parts balance.
        couple = car.mass * car.h_cg - sum(moments) - sum(hubs)
        shares = car.roll_share_front, 1 - car.roll_share_front
        tracks = car.track_front, car.track_rear
        front, rear = (
            LateralTransfer(share * couple / t, moment / t, hub / t)
            for share, moment, hub, t in zip(shares, moments, hubs, tracks, strict=True)
        )
        return front, rear

    @property
    def coefficients(self) -> LoadCoefficients:
        """Coefficients for `wheel_loads`."""
        car, carried, (front, rear) = self.vehicle, self._carried, self.lateral_parts
        if self.as_printed:
            return LoadCoefficients(*carried, 0.0, 0.0, 0.0, front.elastic, rear.elastic)
        longitudinal = car.mass * car.h_cg / car.wheelbase
        return LoadCoefficients(
            *carried, car.C_l_front, car.C_l_rear, longitudinal, sum(front), sum(rear)
        )

    @property
    def _carried(self) -> tuple[float, float]:
        """Mass on each axle at rest [kg]."""
        car = self.vehicle
        return car.mass * car.lr / car.wheelbase, car.mass * car.lf / car.wheelbase


@part
def wheel_loads(c: LoadCoefficients, vx: Any, ax: Any, ay: Any, gravity: Any) -> tuple[Any, ...]:
    """Return loads in the order of `WheelLoads`, for numbers or arrays, compiled or not."""
    air = vx * vx
    front = np.maximum(c.mass_front * gravity + c.C_l_front * air - c.longitudinal * ax, 0.0) / 2
    rear = np.maximum(c.mass_rear * gravity + c.C_l_rear * air + c.longitudinal * ax, 0.0) / 2
    at_front = np.minimum(np.maximum(c.lateral_front * ay, -front), front)
    at_rear = np.minimum(np.maximum(c.lateral_rear * ay, -rear), rear)
    return front - at_front, front + at_front, rear - at_rear, rear + at_rear
