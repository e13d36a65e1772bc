"""Path tracking by Eq. 13-15 as they are printed; `steering_control` has them corrected."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miho.driving.path_tracking import LateralModel, Weights, continuous_gains
from miho.driving.steering_control import FeedForward, SteeringState, TrackingError
from miho.driving.track import Projection, Track
from miho.driving.vehicle import Vehicle
from miho.models.axle import Axle, central_stiffness
from miho.quantities import Array
from miho.validate import positive

INTERVAL = 5.0
"""Width [m/s] of the intervals of velocity with one gain each; the paper gives none."""
FASTEST = 90.0
"""Speed [m/s] at which the last interval ends; its gain is held beyond."""


@dataclass(frozen=True, eq=False)
class PrintedSteering:
    """The regulator delta = -K xi of Eq. 15, as it is printed.

    Attributes
    ----------
    vehicle : Vehicle
        The car, whose largest steering angle limits the command.
    model : LateralModel
        The lateral model (Eq. 13), with B C D of Eq. 14 as cornering stiffnesses [N/rad].
    K : ndarray, shape (k, 4)
        Gains, a row for each interval of 5 m/s from standstill on.
    period : float
        Time from one command to the next [s], for which a command is held.

    Notes
    -----
    The equations contain neither a feed-forward of curvature and bank nor the delay and the lag of
    the steering. In a steady turn the regulator therefore needs an error to steer at all.
    The paper leaves some quantities open. They are read as follows.

    - The matrices of the model, which are not printed, are those of Rajamani, Vehicle Dynamics and
      Control (2011), Ch. 2.5, to whom the paper refers. The stiffnesses are of whole axles, since
      the paper fits the sum of both tire forces; the factor 2 of the book does not occur.
    - An axle's B C D is the sum of B C D of its two tire curves.
    - e_psi' is the yaw rate less the path's yaw rate, v_x kappa.
    - Gains over piecewise velocity intervals: each interval of 5 m/s has the gain of its middle.
    - There is no rule for slow driving: the gain of 2.5 m/s holds down to standstill.
    """

    vehicle: Vehicle
    model: LateralModel
    K: Array
    period: float

    def __post_init__(self) -> None:
        positive("period", self.period, "of seconds")

    @classmethod
    def of(
        cls, vehicle: Vehicle, front: Axle, rear: Axle, weights: Weights, period: float = 0.01
    ) -> PrintedSteering:
        """Design the gains for a car with the identified curves of its axles.

        Parameters
        ----------
        vehicle : Vehicle
            The car.
        front, rear : Axle
            Curves of the tires (Eq. 4).
        weights : Weights
            Q and R of Eq. 15.
        period : float, optional
            Time from one command to the next [s].

        Returns
        -------
        PrintedSteering
            The regulator.
        """
        C_f, C_r = (
            float(central_stiffness(axle.left) + central_stiffness(axle.right))
            for axle in (front, rear)
        )
        model = LateralModel(car=vehicle.single_track, C_f=C_f, C_r=C_r)
        middles = np.arange(INTERVAL / 2, FASTEST, INTERVAL)
        K = np.array([continuous_gains(model, weights, float(v)) for v in middles])
        return cls(vehicle, model, K, period)

    @property
    def initial(self) -> SteeringState:
        """The state of a regulator without a memory."""
        return SteeringState(())

    def feed_forward(self, vx: float, curvature: float, bank: float) -> FeedForward:
        """Steering angle L kappa [rad] and no slip: a guess where a measurement is missing."""
        return FeedForward(self.vehicle.wheelbase * curvature, 0.0)

    def command(
        self,
        state: SteeringState,
        line: Track,
        at: Projection,
        error: TrackingError,
        vx: float,
        steering: float,
    ) -> tuple[float, SteeringState]:
        """The steering command [rad] at a speed vx [m/s], and the unchanged state.

        Line, place and measured angle of the wheels, which `SteeringController` needs, are not
        read.
        """
        row = min(max(int(vx / INTERVAL), 0), len(self.K) - 1)
        largest = self.vehicle.steering_max
        return min(max(-float(self.K[row] @ error), -largest), largest), state
