"""Play (backlash), and a steady brake with play: pressure over command with hysteresis."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from miho.models.model import Model
from miho.quantities import Array
from miho.validate import at_least
from miho.vehicle.models.brake_statics import BrakePressure

CELLS = 16384
"""Rows times configurations of a batch, chosen to fit into a cache."""


def play(values: Array, width: float) -> Array:
    """Return the output of play (backlash), a hysteresis operator.

    The output is constant while the input stays in a band around it. Outside the band, the output
    follows width / 2 below a rising input and width / 2 above a falling input.

    Parameters
    ----------
    values : ndarray of shape (N,)
        Input. The output starts at the first value.
    width : float
        Full width of the band, in the unit of the values, at least 0.

    Returns
    -------
    ndarray of shape (N,)
        Output.

    Raises
    ------
    ValueError
        If the width is negative.

    Examples
    --------
    >>> import numpy as np
    >>> play(np.array([0.0, 1.0, 0.8, 0.0]), 0.5).tolist()
    [0.0, 0.75, 0.75, 0.25]
    """
    at_least("width", width, 0)
    return np.asarray(_played(np.array(values, dtype=float), np.array([width]))[0])


@dataclass(frozen=True)
class BrakePlay(Model):
    """Steady pressure p [Pa] of a circuit over the command u [-], with play in the linkage.

        p = P_max ((v - u0) / (u1 - u0))^n,   0 below u0, P_max above u1
        v_i = min(max(v_{i-1}, u_i - width / 2), u_i + width / 2),   v_0 = u_0

    v is the output of a play operator with the full `width` >= 0 [-] (see `play`). The other
    parameters are the parameters of `BrakePressure`. Rows are one record in order, at any rate;
    v starts at the first command.

    The output is continuous in the parameters and has kinks: in u0 and u1 at the ends of the
    curve, and in `width` at rows where play begins or ends. `jacobian` is exact between kinks.

    References
    ----------
    Krasnosel'skii and Pokrovskii, Systems with Hysteresis (1989). Visintin, Differential Models of
    Hysteresis (1994).
    """

    inputs = MappingProxyType({"u": "-"})
    parameters = MappingProxyType({**BrakePressure.parameters, "width": "-"})
    output = BrakePressure.output
    linear = BrakePressure.linear
    ordered = True

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Pressure [Pa], (n, N)."""
        (u,) = inputs
        pressures = np.empty((thetas.shape[0], u.size))
        together = max(CELLS // max(u.size, 1), 1)
        for i in range(0, thetas.shape[0], together):
            some = thetas[i : i + together]
            pressures[i : i + together] = BrakePressure().predict(
                some[:, :4], _played(u, some[:, 4])
            )
        return pressures

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the pressure with respect to (u0, u1, P_max, n, width), (N, 5)."""
        (u,) = inputs
        (v,) = _played(u, theta[4:])
        static = BrakePressure().jacobian(theta[:4], v)
        by_v = -(static[:, 0] + static[:, 1])  # the curve depends on v - u0 and v - u1 alone
        return np.column_stack([static, by_v * _by_width(u, v, theta[4])])


def _played(u: Array, widths: Array) -> Array:
    """Return outputs (n, N) of play with each width (n,) for a record of commands (N,).

    Each row clips the previous output to a band. Two successive clips are one clip, with the ends
    of the first clipped by the second. The loop therefore joins each row with the rows 1, 2, 4, ...
    before it, until it covers all earlier rows (a parallel prefix scan).
    """
    low, high = u[:, None] - widths / 2, u[:, None] + widths / 2
    low[:1] = high[:1] = u[:1, None]
    step = 1
    while step < u.size:
        below, above = low[step:], high[step:]
        joined = [np.minimum(np.maximum(end[:-step], below), above) for end in (low, high)]
        low[step:], high[step:] = joined
        step *= 2
    return high.T


def _by_width(u: Array, v: Array, width: float) -> Array:
    """Return the derivative (N,) of the output v (N,) by the width, set by the last moving row."""
    before = np.append(u[:1], v[:-1])
    risen, fallen = u - width / 2 > before, u + width / 2 < before
    last = np.maximum.accumulate(np.where(risen | fallen, np.arange(u.size), 0))
    return np.where(risen, -0.5, np.where(fallen, 0.5, 0.0))[last]
