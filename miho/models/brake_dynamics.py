"""The dynamic brake: how its pressure follows the command, with delay, lag and play."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from miho.models.model import Model
from miho.quantities import Array
from miho.validate import at_least


def play(values: Array, width: float) -> Array:
    """Play (backlash) of a full width, in the unit of the values (N,): a loop of hysteresis.

    The output rests until the input has left the band of that width around it, and is then
    dragged along, width / 2 below a rising input and above a falling one. It starts at the first
    value.
    """
    at_least("width", width, 0)
    half = width / 2
    output = np.array(values, dtype=float)
    for i in range(1, output.size):
        output[i] = min(max(output[i - 1], output[i] - half), output[i] + half)
    return output


@dataclass(frozen=True)
class BrakeResponse(Model):
    """Pressure p [Pa] over time t [s], from the steady pressure that is commanded, target [Pa].

        tau dp/dt = target(t - delay) - p,   tau = tau_rise where p rises, tau_fall where it falls

    delay >= 0, tau_rise > 0 and tau_fall > 0 in s. Rows are one record in the order of time, at
    any distance; a target holds until the next row, and p is at rest at the first target before
    the record begins. Under these conditions the values are the exact solution, for any delay.

    A row depends on those before it: this model cannot be fitted to some of the rows, nor to rows
    in another order, for which it raises ValueError.
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
        # At its delayed start a step finds a pressure that does not depend on the delay.
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

        At the instant at which a step arrives they are those after it.
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
    """Times at which the target changes, the first row's among them, and its values from there."""
    if not (np.diff(t) > 0).all():
        raise ValueError("t does not increase from row to row; give one record in order of time")
    changes = np.flatnonzero(np.diff(target, prepend=np.nan) != 0)
    return t[changes], target[changes]


def _position(t: Array, starts: Array, delay: Array) -> tuple[NDArray[np.intp], Array]:
    """The step that each row is in, and for how long it has been [s], (n, N) each."""
    delayed = t - delay[:, None]
    k = np.maximum(np.searchsorted(starts, delayed, side="right") - 1, 0)
    return k, np.maximum(delayed - starts[k], 0.0)
