"""Path tracking by Eq. 13-15 as printed; `steering_control` has the corrected equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miho.quantities import Array
from miho.validate import positive
from miho.vehicle.driving.path_tracking import LateralModel, Weights, continuous_gains
from miho.vehicle.driving.steering_control import FeedForward, SteeringState, TrackingError
from miho.vehicle.driving.track import Projection, Track
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.models.axle import Axle, central_stiffness

INTERVAL = 5.0
"""Width of the velocity intervals with one gain each [m/s]; the paper does not state it."""
FASTEST = 90.0
"""End of the last interval [m/s], whose gain is used at higher speeds."""


@dataclass(frozen=True, eq=False)
class PrintedSteering:
    """The regulator delta = -K xi of Eq. 15 as printed.

    The equations contain no feed-forward of curvature and bank, and no delay and lag of the
    steering. In a steady turn, the regulator therefore steers only with an error. The page on
    driving of the manual lists how quantities that the paper leaves open are interpreted.
    """

    vehicle: Vehicle  # its largest steering angle limits the command
    model: LateralModel  # Eq. 13, with B C D of Eq. 14 as cornering stiffnesses [N/rad]
    K: Array  # (k, 4), one row for each interval of 5 m/s from standstill
    period: float  # time between commands [s]; a command is held over it

    def __post_init__(self) -> None:
        positive("period", self.period, "of seconds")

    @classmethod
    def of(
        cls, vehicle: Vehicle, front: Axle, rear: Axle, weights: Weights, period: float = 0.01
    ) -> PrintedSteering:
        """Return the regulator of a car with identified curves (Eq. 4), Q and R of Eq. 15."""
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
        """Empty state, because the regulator has no memory."""
        return SteeringState(())

    def feed_forward(self, vx: float, curvature: float, bank: float) -> FeedForward:
        """Return the steering angle L kappa [rad] without slip, for missing measurements."""
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
        """Return the steering command [rad] at a speed vx [m/s], and the unchanged state.

        `line`, `at` and `steering` are not used; `SteeringController` needs them.
        """
        row = min(max(int(vx / INTERVAL), 0), len(self.K) - 1)
        largest = self.vehicle.steering_max
        return min(max(-float(self.K[row] @ error), -largest), largest), state
