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
        """Return the slip angles [rad] of the axles, for forward driving (vx > 0)."""
        vx, vy, yaw_rate = np.asarray(vx), np.asarray(vy), np.asarray(yaw_rate)
        front = np.arctan2(vy + self.lf * yaw_rate, vx) - np.asarray(steering)
        return FrontRear(front, np.asarray(np.arctan2(vy - self.lr * yaw_rate, vx)))

    def axle_forces(
        self,
        ay: ArrayLike,
        yaw_acceleration: ArrayLike,
        steering: ArrayLike,
        bank: ArrayLike = 0.0,
    ) -> FrontRear:
        """Return the lateral forces [N] of the axles, each in the frame of its wheels.

        ay is v_y' + v_x r, along the road surface. bank [rad] is positive if the left side is
        lower, as on a left-hand oval; the weight then contributes m g sin(bank).
        """
        lateral = self.mass * (np.asarray(ay) - g * np.sin(bank))
        moment = self.Izz * np.asarray(yaw_acceleration)
        wheelbase = self.lf + self.lr
        front = (self.lr * lateral + moment) / (wheelbase * np.cos(steering))
        return FrontRear(np.asarray(front), np.asarray((self.lf * lateral - moment) / wheelbase))
