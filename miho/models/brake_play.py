"""The steady brake with play: pressure over command, with a loop of hysteresis."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from miho.compiled.signature import compiled_when_called
from miho.models.brake_statics import BrakePressure
from miho.models.model import Model
from miho.quantities import Array


@dataclass(frozen=True)
class BrakePlay(Model):
    """Steady pressure p [Pa] of a circuit over the command u [-], behind play in the linkage.

        p = P_max ((v - u0) / (u1 - u0))^n,   0 below u0, P_max above u1
        v_i = min(max(v_{i-1}, u_i - width / 2), u_i + width / 2),   v_0 = u_0

    v is the play operator (Krasnosel'skii and Pokrovskii, Systems with Hysteresis, 1989;
    Visintin, Differential Models of Hysteresis, 1994) of the full `width` >= 0 [-]: it rests until
    the command has left the band around it, and is then dragged along behind. The other
    parameters are those of `BrakePressure`. The rows are one record in its order, however fast it
    was taken; v starts at the first command.

    The output is continuous in the parameters but has kinks: in u0 and u1 where the curve begins
    and ends, and in `width` where the dragging of a row begins or ends. Between kinks `jacobian`
    is exact, and no derivative tells of those ahead.
    """

    inputs = MappingProxyType({"u": "-"})
    parameters = MappingProxyType({**BrakePressure.parameters, "width": "-"})
    output = BrakePressure.output
    linear = BrakePressure.linear
    ordered = True

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Pressure [Pa], (n, N)."""
        (u,) = inputs
        return np.asarray(_pressures(np.ascontiguousarray(thetas), np.ascontiguousarray(u)))

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the pressure with respect to (u0, u1, P_max, n, width), (N, 5)."""
        (u,) = inputs
        v, by_width = _played(np.ascontiguousarray(u), theta[4])
        static = BrakePressure().jacobian(theta[:4], v)
        by_v = -(static[:, 0] + static[:, 1])  # the curve depends on v - u0 and v - u1 alone
        return np.column_stack([static, by_v * by_width])


@compiled_when_called(error_model="numpy")
def _pressures(thetas: Array, u: Array) -> Array:
    """Pressures (n, N) of parameter rows (n, 5) at a record of commands (N,)."""
    pressures = np.empty((thetas.shape[0], u.size))
    for i in range(thetas.shape[0]):
        u0, u1, P_max = thetas[i, 0], thetas[i, 1], thetas[i, 2]
        n, half = thetas[i, 3], thetas[i, 4] / 2
        v, x, share = u[0], 0.0, 0.0
        for j in range(u.size):
            v = min(max(v, u[j] - half), u[j] + half)
            before, x = x, min(max((v - u0) / (u1 - u0), 0.0), 1.0)
            if x != before:  # the power is what costs, and a resting v repeats it
                share = x**n
            pressures[i, j] = P_max * share
    return pressures


@compiled_when_called()
def _played(u: Array, width: float) -> tuple[Array, Array]:
    """The output v of the play at each command, and its derivative in the width, (N,) each."""
    played, slope = np.empty(u.size), np.empty(u.size)
    v, by_width = u[0], 0.0
    for j in range(u.size):
        if u[j] - width / 2 > v:
            v, by_width = u[j] - width / 2, -0.5
        elif u[j] + width / 2 < v:
            v, by_width = u[j] + width / 2, 0.5
        played[j], slope[j] = v, by_width
    return played, slope
