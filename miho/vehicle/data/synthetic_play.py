"""A synthetic brake test with play in the pedal linkage: sweeps of the command with reversals."""

from __future__ import annotations

import numpy as np

from miho.data.dataset import Dataset
from miho.quantities import Array
from miho.validate import at_least, whole
from miho.vehicle.data.synthetic_brake import EMBEDDED_BRAKE
from miho.vehicle.models.brake_dynamics import play

PLAY = 0.06
"""Full width of the play [-], in units of the command. The pressure curve is `EMBEDDED_BRAKE`."""

TURNS = (0.0, 1.0, 0.0, 0.8, 0.35, 0.6, 0.5, 0.55, 0.2, 0.9, 0.7, 0.76, 0.1, 0.3, 0.0)
"""Turning points of the command: a full loop, inner loops, and reversals within the play."""


def brake_play_test(seed: int = 0, samples: int = 800, noise: float = 5.0e4) -> Dataset:
    """Slow sweeps of the command between `TURNS` and the settled pressure of the front circuit.

    Parameters
    ----------
    seed : int
        Seed of the noise.
    samples : int
        Number of samples, at equal steps along the path of the command.
    noise : float
        Standard deviation of the normal noise of the pressure [Pa].

    Returns
    -------
    Dataset
        Columns u [-] and the output p [Pa], in the order of measurement.

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """
    whole("seed", seed, 0)
    whole("samples", samples, len(TURNS))
    at_least("noise", noise, 0)
    rng = np.random.default_rng([seed, *b"play"])
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(TURNS)))])
    u: Array = np.interp(np.linspace(0.0, travelled[-1], samples), travelled, TURNS)
    p = EMBEDDED_BRAKE.pressure(play(u, PLAY))[0] + noise * rng.standard_normal(samples)
    return Dataset("brake_play", {"u": u, "p": p}, {"u": "-", "p": "Pa"}, "p")
