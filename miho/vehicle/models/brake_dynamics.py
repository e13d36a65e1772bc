"""Dynamic brake: response of the pressure to the command, with delay and lag."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from miho.models.model import Model
from miho.quantities import Array


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
