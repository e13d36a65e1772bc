"""The single-track model: slip angles and lateral forces of the two axles."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from miho.quantities import Array, g
from miho.validate import positive_settings


class FrontRear(NamedTuple):
    """A quantity at both axles.

    Attributes
    ----------
    front, rear : ndarray
        Values at the front and at the rear axle.
    """

    front: Array
    rear: Array


@dataclass(frozen=True, kw_only=True)
class SingleTrack:
    """Single-track model of a car, with the wheels of each axle combined, in ISO-W signs.

        alpha_f = atan2(v_y + l_f r, v_x) - delta        m a_y = F_yf cos(delta) + F_yr
        alpha_r = atan2(v_y - l_r r, v_x)               I_zz r' = l_f F_yf cos(delta) - l_r F_yr

    x points forward, y to the left, z up. v_x, v_y [m/s] and a_y [m/s^2] refer to the centre of
    gravity. The yaw rate r [rad/s] and the steering angle delta of the road wheels [rad] are
    positive to the left. In a left turn, slip angles are negative and forces positive. The model
    neglects the driving force of the front wheels, their aligning torque and camber thrust.

    Parameters
    ----------
    mass : float
        m [kg].
    lf, lr : float
        Distance from the centre of gravity to the front and rear axle [m].
    Izz : float
        Yaw inertia [kg m^2].

    Raises
    ------
    ValueError
        If a parameter is not positive.

    Examples
    --------
    >>> from miho.vehicle.models import SingleTrack
    >>> car = SingleTrack(mass=700.0, lf=1.7, lr=1.3, Izz=900.0)
    >>> angles = car.slip_angles(vx=30.0, vy=0.0, yaw_rate=0.2, steering=0.03)
    >>> round(float(angles.front), 4), round(float(angles.rear), 4)
    (-0.0187, -0.0087)
    """

    mass: float
    lf: float
    lr: float
    Izz: float

    def __post_init__(self) -> None:
        positive_settings(self, [field.name for field in fields(self)])

    def slip_angles(
        self, vx: ArrayLike, vy: ArrayLike, yaw_rate: ArrayLike, steering: ArrayLike
    ) -> FrontRear:
        """Return the slip angles of the axles, for forward driving.

        Parameters
        ----------
        vx, vy : array_like
            Velocity of the centre of gravity [m/s], vx > 0.
        yaw_rate : array_like
            Yaw rate [rad/s].
        steering : array_like
            Angle of the road wheels [rad].

        Returns
        -------
        FrontRear
            Slip angles [rad].
        """
        vx, vy, yaw_rate = np.asarray(vx), np.asarray(vy), np.asarray(yaw_rate)
        front = np.arctan2(vy + self.lf * yaw_rate, vx) - np.asarray(steering)
        return FrontRear(front, np.asarray(np.arctan2(vy - self.lr * yaw_rate, vx)))

    def axle_forces(
        self, ay: ArrayLike, yaw_acceleration: ArrayLike, steering: ArrayLike, bank: ArrayLike = 0.0
    ) -> FrontRear:
        """Return the lateral forces of the axles, each in the frame of its wheels.

        Parameters
        ----------
        ay : array_like
            v_y' + v_x r, along the road surface [m/s^2].
        yaw_acceleration : array_like
            Derivative of the yaw rate [rad/s^2].
        steering : array_like
            Angle of the road wheels [rad].
        bank : array_like, optional
            Positive if the left side is lower, as on a left-hand oval [rad]; the weight then
            contributes m g sin(bank).

        Returns
        -------
        FrontRear
            Lateral forces [N].
        """
        lateral = self.mass * (np.asarray(ay) - g * np.sin(bank))
        moment = self.Izz * np.asarray(yaw_acceleration)
        wheelbase = self.lf + self.lr
        front = (self.lr * lateral + moment) / (wheelbase * np.cos(steering))
        return FrontRear(np.asarray(front), np.asarray((self.lf * lateral - moment) / wheelbase))
