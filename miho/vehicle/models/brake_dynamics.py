"""Response of the brake pressure to the command: delay and lag, or play (hysteresis)."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from miho.models.model import Model
from miho.quantities import Array
from miho.validate import at_least
from miho.vehicle.models.brake_statics import BrakePressure


@dataclass(frozen=True)
class BrakeResponse(Model):
    """Pressure p [Pa] over time t [s], from the commanded steady pressure, target [Pa].

        tau dp/dt = target(t - delay) - p,   tau = tau_rise if p rises, tau_fall if it falls

    The parameters are delay >= 0, tau_rise > 0 and tau_fall > 0 [s]. Rows are one record in order
    of time, at any distance. A target is held until the next row, and p is at rest at the first
    target before the record begins. Values are the exact solution under these conditions, for any
    delay. A row depends on the earlier rows; rows in another order raise ValueError.
    """

    inputs = MappingProxyType({"t": "s", "target": "Pa"})
    parameters = MappingProxyType({"delay": "s", "tau_rise": "s", "tau_fall": "s"})
    output = "Pa"
    ordered = True

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Pressure [Pa], (n, N)."""
        t, target = inputs
        starts, levels = _steps(t, target)
        delay, rise, fall = thetas.T
        # The pressure at the delayed start of a step does not depend on the delay.
        P = np.empty((len(starts), len(thetas)))
        tau = np.empty_like(P)
        P[0] = levels[0]
        tau[0] = rise
        for i in range(1, len(starts)):
            decay = np.exp((starts[i - 1] - starts[i]) / tau[i - 1])
            P[i] = levels[i - 1] + (P[i - 1] - levels[i - 1]) * decay
            tau[i] = np.where(levels[i] > P[i], rise, fall)
        k, elapsed = _position(t, starts, delay)
        row = np.arange(len(thetas))[:, None]
        return np.asarray(levels[k] + (P[k, row] - levels[k]) * np.exp(-elapsed / tau[k, row]))

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the pressure with respect to (delay, tau_rise, tau_fall), (N, 3).

        At the arrival of a step, they are right-hand derivatives.
        """
        t, target = inputs
        starts, levels = _steps(t, target)
        delay, *taus = theta
        P = np.empty(len(starts))
        d_P = np.zeros((len(starts), 2))  # with respect to tau_rise, tau_fall
        side = np.zeros(len(starts), dtype=int)
        P[0] = levels[0]
        for i in range(1, len(starts)):
            h, tau = starts[i] - starts[i - 1], taus[side[i - 1]]
            decay = np.exp(-h / tau)
            gap = (P[i - 1] - levels[i - 1]) * decay
            P[i] = levels[i - 1] + gap
            d_P[i] = d_P[i - 1] * decay
            d_P[i, side[i - 1]] += gap * h / tau**2
            side[i] = 0 if levels[i] > P[i] else 1
        k, elapsed = (part[0] for part in _position(t, starts, np.array([delay])))
        lag = np.array(taus)[side[k]]
        decays = np.exp(-elapsed / lag)
        gaps = (P[k] - levels[k]) * decays
        J = np.empty((t.size, 3))
        J[:, 0] = gaps / lag
        J[:, 1:] = d_P[k] * decays[:, None]
        J[np.arange(t.size), 1 + side[k]] += gaps * elapsed / lag**2
        return J


def _steps(t: Array, target: Array) -> tuple[Array, Array]:
    """Return the times at which the target changes, from the first row on, and its new values."""
    if not (np.diff(t) > 0).all():
        raise ValueError(
            "t does not increase from row to row; sort the rows by time and give one record"
        )
    changes = np.flatnonzero(np.diff(target, prepend=np.nan) != 0)
    return t[changes], target[changes]


def _position(t: Array, starts: Array, delay: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the step of each row, and the time since its start [s], (n, N) each."""
    delayed = t - delay[:, None]
    k = np.maximum(np.searchsorted(starts, delayed, side="right") - 1, 0)
    return k, np.maximum(delayed - starts[k], 0.0)


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
