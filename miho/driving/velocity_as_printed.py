"""The velocity plan with Eq. 10-12 as they are printed, to be compared with `velocity_planner`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miho.driving.grip import Grip
from miho.driving.load_transfer import LoadTransfer
from miho.driving.track import Track
from miho.driving.vehicle import Vehicle
from miho.quantities import Array


@dataclass(frozen=True)
class PrintedPlanner:
    """Speeds by the printed equations; each switch mends one of them.

        F_y,i^max = mu (F_z,i / F_z,i^nominal) F_y,i^peak                               (Eq. 10)
        a_y,max = (F_y,r^max + F_y,f^max cos(delta) - m v_x psi') / m                   (Eq. 11)
        v_x,des = sqrt(a_y,max / kappa)                                                 (Eq. 12)

    The loads are static: the printed load transfer has the rate of the lateral velocity, which is
    zero in a steady turn. `transfer` computes them with the lateral acceleration that comes out;
    since the force is in proportion to the load, that changes the sum of an axle only as far as
    its two tires differ. On a steady turn psi' = v_x kappa, so that a_y,max is what the speed
    itself makes of it: half of the limit, and the speed 0.707 of it. `yaw_term` False leaves that
    term out. delta = L kappa. Where the road is straight, the top speed [m/s] stands.
    """

    vehicle: Vehicle
    grip: Grip
    mu: float = 1.0
    top_speed: float = 90.0
    transfer: bool = False
    yaw_term: bool = True

    def speeds(self, line: Track) -> Array:
        """Speeds [m/s] at the points of a line, (n,)."""
        bend = np.maximum(np.abs(line.curvature), 1e-9)
        force = self._force(np.zeros(bend.size), line.curvature)
        for _ in range(20 if self.transfer else 0):
            force = self._force(force / self.vehicle.mass, line.curvature)
        ay_max = force / self.vehicle.mass
        # With psi' = v kappa, Eq. 11 and 12 are v^2 kappa = ay_max - v^2 kappa.
        v = np.sqrt(ay_max / (2 if self.yaw_term else 1) / bend)
        return np.asarray(np.minimum(v, self.top_speed))

    def _force(self, ay: Array, curvature: Array) -> Array:
        """F_y,r^max + F_y,f^max cos(delta) [N] at lateral accelerations (n,), towards the bend."""
        toward = np.where(curvature < 0, -1.0, 1.0)
        loads = np.stack(LoadTransfer(self.vehicle).wheel_loads(0.0, 0.0, toward * ay), axis=1)
        peaks = np.where(curvature[:, None] < 0, self.grip.right, self.grip.left)
        forces = self.mu * loads / self.grip.load * peaks
        steered = np.cos(self.vehicle.wheelbase * curvature)
        return np.asarray(forces[:, 2:].sum(axis=1) + steered * forces[:, :2].sum(axis=1))
