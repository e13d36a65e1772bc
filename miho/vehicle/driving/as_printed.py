"""Plans by Eq. 10-12 and path tracking by Eq. 13-15, as printed.

`velocity_planner` and `steering_control` have the corrected equations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from miho.quantities import Array, g
from miho.validate import positive, positive_settings
from miho.vehicle.driving.friction import friction_car
from miho.vehicle.driving.grip import Grip
from miho.vehicle.driving.load_transfer import LoadTransfer
from miho.vehicle.driving.path_tracking import LateralModel, Weights, continuous_gains
from miho.vehicle.driving.plant import Motion
from miho.vehicle.driving.steering_control import FeedForward, SteeringState, TrackingError
from miho.vehicle.driving.track import Projection, Track
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.driving.velocity_planner import VelocityPlan
from miho.vehicle.models.axle import Axle, central_stiffness

STRAIGHT = 1e-9
"""Smallest curvature [1/m] in Eq. 12."""


@dataclass(frozen=True)
class PrintedPlanner:
    """Speeds by the printed equations, for a whole line or for the measured motion of a car.

        C_roll = m_s v_y' h_a                                                        (Sec. IV-A)
        F_y,i^max = mu (F_z,i / F_z,i^nominal) F_y,i^peak                               (Eq. 10)
        a_y,max = (F_y,r^max + F_y,f^max cos(delta) - m v_x psi') / m                   (Eq. 11)
        v_x,des = sqrt(a_y,max / kappa)                                                 (Eq. 12)

    The page on driving of the manual lists how quantities that the paper leaves open are
    interpreted. Downforce, banking and longitudinal load transfer do not occur in the equations.

    `speeds` and `plan` assume that the car follows the line in a steady turn: v_y' = 0,
    psi' = v_x kappa and delta = L kappa. Eq. 11 and 12 are then 2 v_x^2 kappa = F / m with the
    force F of both axles, so the speed is sqrt(1/2) = 0.707 times the limit of these forces.
    `speed` uses the measured motion.
    """

    vehicle: Vehicle  # load transfer uses only the roll couple of its suspension
    grip: Grip  # without its load sensitivities
    mu: float = 1.0  # performance factor of Eq. 10 [-]
    top_speed: float = 90.0  # [m/s]; Eq. 12 gives no limit on a straight
    transfer: bool = False  # load transfer by the lateral acceleration of the plan, not by v_y'
    yaw_term: bool = True  # m v_x psi' of Eq. 11

    def __post_init__(self) -> None:
        positive_settings(self, ("mu", "top_speed"))

    def plan(self, line: Track) -> VelocityPlan:
        """Return speeds by Eq. 12 for laps of a line.

        `lateral` is v_x^2 kappa, `limit` is a_y,max of Eq. 11 at these speeds [m/s^2], and `use` is
        their ratio. Accelerations between points are not limited. `friction` has the limits of the
        corrected plan, for the evaluation of drives.
        """
        v = self.speeds(line)
        lateral = v**2 * line.curvature
        yaw = np.abs(lateral) if self.yaw_term else 0.0
        limit = self._ay_max(line) - yaw
        ax = (np.roll(v, -1) ** 2 - v**2) / (2 * line.step)
        friction = friction_car(self.vehicle, self.grip, self.mu)
        return VelocityPlan(line, v, ax, lateral, limit, np.abs(lateral) / limit, friction)

    def speeds(self, line: Track) -> Array:
        """Return the desired speeds [m/s] at the points of a line in a steady turn, (n,)."""
        bend = np.maximum(np.abs(line.curvature), STRAIGHT)
        # With psi' = v kappa, Eq. 11 and 12 become v^2 kappa = F / m - v^2 kappa.
        v = np.sqrt(self._ay_max(line) / (2 if self.yaw_term else 1) / bend)
        return np.asarray(np.minimum(v, self.top_speed))

    def speed(self, motion: Motion, curvature: float, bank: float = 0.0) -> float:
        """Return v_x,des [m/s], from 0 to the top speed, for the measured motion of a car.

        The accelerometer gives v_y' = a_y + g sin(bank) - v_x psi'; with `transfer`, load transfer
        follows from a_y. Curvature [1/m] and bank [rad] are at the car, without preview.
        """
        turning = motion.vx * motion.yaw_rate
        vy_rate = motion.ay + g * math.sin(bank) - turning
        moving = motion.ay if self.transfer else vy_rate
        rear, front = self._axles(np.array([moving]), np.array([curvature]))
        ay_max = float(rear[0] + front[0] * math.cos(motion.steering)) / self.vehicle.mass
        if self.yaw_term:
            ay_max -= math.copysign(1.0, curvature) * turning
        bend = max(abs(curvature), STRAIGHT)
        return min(math.sqrt(max(ay_max, 0.0) / bend), self.top_speed)

    def _ay_max(self, line: Track) -> Array:
        """Return Eq. 11 without the yaw term, (n,) [m/s^2], for a car on a line."""
        toward = np.where(line.curvature < 0, -1.0, 1.0)
        ay = np.zeros(line.curvature.size)
        for _ in range(21 if self.transfer else 1):
            rear, front = self._axles(toward * ay, line.curvature)
            ay = (rear + front * np.cos(self.vehicle.wheelbase * line.curvature)) / (
                self.vehicle.mass
            )
        return np.asarray(ay)

    def _axles(self, moving: Array, curvature: Array) -> tuple[Array, Array]:
        """Return F_y,r^max and F_y,f^max [N], (n,), by Eq. 10 at accelerations `moving`, (n,)."""
        transfer = LoadTransfer(self.vehicle, as_printed=not self.transfer)
        loads = np.stack(transfer.wheel_loads(0.0, 0.0, moving, vy_rate=moving), axis=1)
        peaks = np.where(curvature[:, None] < 0, self.grip.right, self.grip.left)
        forces = self.mu * loads / self.grip.load * peaks
        return forces[:, 2:].sum(axis=1), forces[:, :2].sum(axis=1)


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
