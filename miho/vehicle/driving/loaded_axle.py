"""An axle with tire curves at one load each, transferred to other loads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from miho.quantities import Array
from miho.vehicle.driving.load_transfer import LoadTransfer
from miho.vehicle.models.axle import Axle, curve_model
from miho.vehicle.models.load_scaling import LoadSensitivity, at_load

ITERATIONS = 60
"""Fixed-point iterations of force and load transfer; each halves the error or better."""


@dataclass(frozen=True, eq=False)
class LoadedAxle:
    """Curves of two tires with the loads at which they were identified."""

    axle: Axle
    loads: Array  # (2,), left and right [N]
    sensitivity: LoadSensitivity  # of each tire at its load, (2,) each, or numbers for both

    def at(self, loads: ArrayLike) -> Axle:
        """Return the axle at loads [N] of the left and the right wheel, (2,)."""
        left, right = (self._curve(side, load) for side, load in enumerate(np.asarray(loads)))
        return Axle(left, right)

    def in_turn(self, alpha: ArrayLike, load: float, transfer: float) -> Array:
        """Return the lateral force of both tires [N] in steady turns, including load transfer.

        The slip angles [rad], of any shape, are ISO-W. `load` is the load of both wheels [N], and
        `transfer` the load transfer from the left to the right wheel per lateral force [-], at
        least 0 (see `transfer_per_force`). Raises ValueError if forces and loads do not converge.
        """
        slip = np.asarray(alpha, dtype=float)
        force = self.at([load / 2, load / 2]).force(slip)
        for _ in range(ITERATIONS):
            moved = np.clip(transfer * force, -load / 2, load / 2)
            before, force = force, self._force(slip, load / 2 - moved, load / 2 + moved)
        if not np.allclose(force, before, rtol=0.0, atol=1e-6 * load):
            raise ValueError(
                f"transfer is {transfer:g}; expected a smaller load transfer, for which forces and "
                "loads converge"
            )
        return force

    def _force(self, slip: Array, left: Array, right: Array) -> Array:
        """Return the sum of both tires at loads [N] of the same shape as the slip angles."""
        total = np.zeros(slip.shape)
        for side, load in enumerate((left, right)):
            theta = self._curve(side, load)
            total += curve_model(theta).value((slip,), tuple(np.moveaxis(theta, -1, 0)))
        return total

    def _curve(self, side: int, load: ArrayLike) -> Array:
        peak, stiffness = (np.broadcast_to(part, 2)[side] for part in self.sensitivity)
        theta = (self.axle.left, self.axle.right)[side]
        ratio = np.asarray(load) / self.loads[side]
        return at_load(theta, ratio, LoadSensitivity(peak, stiffness))


def transfer_per_force(transfer: LoadTransfer) -> tuple[float, float]:
    """Return the load transfer of the front and the rear axle per lateral force [-].

    In a steady turn, the lateral force of an axle belongs to the mass that it carries at rest.
    """
    c = transfer.coefficients
    return c.lateral_front / c.mass_front, c.lateral_rear / c.mass_rear
