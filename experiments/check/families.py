"""Families of curves drawn by seed: smooth ones, peaks, periods, kinks, and hard ones.

Each draw has new parameters, rows and noise. The boxes are as wide as a user would choose them who
knows little about the parameters.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from miho import CurveFit, Dataset, Parameter, Space
from miho.models import FunctionModel
from miho.quantities import Array

Draw = tuple[list[Array], list[float], float]
LOUDER = 0.3, 2.0
"""Range of the factor between the noise of a draw and the noise of its family."""


@dataclass(frozen=True)
class Family:
    """Curves of one formula.

    Parameters
    ----------
    kind : str
        "smooth", "peaks", "periods", "kinks", "many minima", "wide periods" or "unlike parts".
    formula : callable
        A function of columns and then parameters.
    box : tuple of (low, high)
        The bounds of each parameter.
    draw : callable
        A function of a generator; gives the columns, the true parameters, and the noise.
    """

    kind: str
    formula: Callable[..., Array]
    box: tuple[tuple[float, float], ...]
    draw: Callable[[np.random.Generator], Draw]

    def problem(self, rng: np.random.Generator) -> tuple[CurveFit, float]:
        """Draw a problem, and return it with the loss after a descent from the true parameters."""
        columns, true, noise = self.draw(rng)
        noise *= _log(rng, *LOUDER)
        fit = drawn(self.formula, columns, true, noise, self.box, rng)
        low, high = fit.space.low, fit.space.high
        start = np.clip(np.array(true, dtype=float), low, high)
        descent = least_squares(fit.residuals, start, bounds=(low, high), x_scale=high - low)
        return fit, 2 * float(descent.cost) / columns[0].size


def drawn(
    formula: Callable[..., Array],
    columns: Sequence[Array],
    true: Sequence[float],
    noise: float,
    box: Sequence[tuple[float, float]],
    rng: np.random.Generator,
) -> CurveFit:
    """Problem of a formula of columns and then parameters, with normal noise, in a box."""
    names = formula.__code__.co_varnames[: len(columns) + len(true)]
    inputs, parameters = names[: len(columns)], names[len(columns) :]
    y = formula(*columns, *true) + noise * rng.normal(size=columns[0].size)
    data = {**dict(zip(inputs, columns, strict=True)), "y": y}
    dataset = Dataset("drawn", data, dict.fromkeys(data, ""), "y")
    bounds = zip(parameters, box, strict=True)
    space = Space(tuple(Parameter(name, "", low, high) for name, (low, high) in bounds))
    return CurveFit(FunctionModel(formula, columns=inputs), dataset, space, compiled=True)


U = np.random.Generator.uniform


def _even(rng: np.random.Generator, fewest: int, most: int, end: float) -> list[Array]:
    """A column of evenly spaced rows from 0 to an end."""
    return [np.linspace(0, end, int(rng.integers(fewest, most)))]


def _scattered(rng: np.random.Generator, fewest: int, most: int, end: float) -> list[Array]:
    """Two columns of rows at random places."""
    return list(rng.uniform(0, end, (2, int(rng.integers(fewest, most)))))


def _pixels(rng: np.random.Generator) -> list[Array]:
    """Two columns with the positions of the pixels of an image."""
    n = int(rng.integers(14, 30))
    return [side.ravel() for side in np.meshgrid(np.arange(n) / n, np.arange(n) / n)]


def _decades(rng: np.random.Generator, fewest: int, most: int, low: float) -> list[Array]:
    """A column of rows with logarithmic spacing from `low` to a thousand times `low`."""
    return [np.geomspace(low, 1000 * low, int(rng.integers(fewest, most)))]


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _peak(x: Array, c: float, w: float) -> Array:
    return np.exp(-(((x - c) / w) ** 2))


def _hump(x: Array, c: float, w: float) -> Array:
    return 1 / (1 + ((x - c) / w) ** 2)


def _step(x: Array) -> Array:
    return 1 / (1 + np.exp(-x))


PERIOD = (2.0, 200.0)
PEAK = ((0.0, 20.0), (0.0, 100.0), (0.5, 50.0))
PHASE = (0.0, 6.3)
FAMILIES = {
    # Smooth curves with correlated parameters.
    "two decays": Family(
        "smooth",
        lambda x, a, k, b, h, m: m + a * np.exp(-k * x) + b * np.exp(-h * x),
        ((-10, 10), (0, 10), (-10, 10), (0, 10), (-5, 5)),
        lambda r: (_even(r, 30, 150, 10), [2, U(r, 0.1, 0.5), 1, U(r, 1, 5), 0.2], 0.05),
    ),
    "binding at two sites": Family(
        "smooth",
        lambda x, a, k, b, h: a * x / (k + x) + b * x / (h + x),
        ((0, 20), (1e-3, 100), (0, 20), (1e-3, 100)),
        lambda r: (_decades(r, 20, 80, 0.1), [3, _log(r, 0.3, 2), 4, _log(r, 8, 60)], 0.05),
    ),
    "activation and inhibition": Family(
        "smooth",
        lambda x, v, k, n, h: v * x**n / (k**n + x**n) / (1 + x / h),
        ((0, 100), (0.01, 100), (0.5, 6), (0.01, 1000)),
        lambda r: (
            _decades(r, 20, 80, 0.1), [10, _log(r, 1, 8), U(r, 1, 3), _log(r, 20, 200)], 0.2
        ),
    ),
    "two steps of growth": Family(
        "smooth",
        lambda x, a, r, t, b, q, s: a * _step(r * (x - t)) + b * _step(q * (x - s)),
        ((0, 20), (0.02, 2), (0, 100)) * 2,
        lambda r: (
            _even(r, 40, 150, 100),
            [4, U(r, 0.1, 0.4), U(r, 15, 35), 5, U(r, 0.1, 0.4), U(r, 60, 85)], 0.15,
        ),
    ),
    "friction that falls and rises": Family(
        "smooth",
        lambda v, c, s, w, n, b: (c + (s - c) * np.exp(-((v / w) ** n))) + b * v,
        ((0, 10), (0, 20), (0.01, 5), (0.5, 3), (0, 5)),
        lambda r: (_even(r, 40, 200, 3), [2, 4, U(r, 0.1, 0.6), U(r, 0.8, 2), U(r, 0.2, 1)], 0.1),
    ),
    "a tire with curvature": Family(
        "smooth",
        lambda a, B, C, D, E: (
            D * np.sin(C * np.arctan(B * a - E * (B * a - np.arctan(B * a))))
        ),
        ((1, 40), (0.8, 2.5), (0, 3), (-5, 1)),
        lambda r: (
            [np.linspace(-0.3, 0.3, int(r.integers(50, 300)))],
            [U(r, 6, 18), U(r, 1.1, 1.8), 1, U(r, -1, 0.5)], 0.03,
        ),
    ),
    "absorbed with a lag": Family(
        "smooth",
        lambda t, F, ka, k, lag: (
            F * ka / (ka - k + 1e-9)
            * (np.exp(-k * np.maximum(t - lag, 0)) - np.exp(-ka * np.maximum(t - lag, 0)))
        ),
        ((0, 100), (0.01, 10), (0.01, 10), (0, 5)),
        lambda r: (
            _even(r, 25, 80, 24), [10, U(r, 0.6, 2), U(r, 0.05, 0.3), U(r, 0.2, 1.5)], 0.25
        ),
    ),
    # Peaks, steps and pulses, whose positions must be found.
    "two peaks on a line": Family(
        "peaks",
        lambda x, m, s, a, c, w, b, d, v: m + s * x + a * _peak(x, c, w) + b * _peak(x, d, v),
        ((-5, 5), (-0.1, 0.1), *PEAK, *PEAK),
        lambda r: (
            _even(r, 60, 300, 100),
            [1, 0.02, U(r, 2, 5), U(r, 10, 45), U(r, 2, 8), U(r, 0.5, 4), U(r, 55, 90), U(r, 2, 8)],
            0.3,
        ),
    ),
    "three peaks": Family(
        "peaks",
        lambda x, a, c, w, b, d, v, e, g, u: (
            a * _peak(x, c, w) + b * _peak(x, d, v) + e * _peak(x, g, u)
        ),
        PEAK * 3,
        lambda r: (
            _even(r, 100, 300, 100),
            [U(r, 2, 5), U(r, 10, 35), U(r, 2, 8), U(r, 0.5, 4), U(r, 40, 65), U(r, 2, 8),
             U(r, 0.5, 4), U(r, 70, 95), U(r, 2, 8)],
            0.1,
        ),
    ),
    "three lines of a spectrum": Family(
        "peaks",
        lambda x, m, s, a, c, w, b, d, v, e, g, u: (
            m + s * x + a * _hump(x, c, w) + b * _hump(x, d, v) + e * _hump(x, g, u)
        ),
        ((-5, 5), (-0.1, 0.1), *PEAK, *PEAK, *PEAK),
        lambda r: (
            _even(r, 120, 400, 100),
            [0.5, 0.01, U(r, 2, 6), U(r, 10, 35), U(r, 1, 5), U(r, 1, 5), U(r, 40, 65), U(r, 1, 5),
             U(r, 0.7, 3), U(r, 70, 95), U(r, 1, 5)],
            0.15,
        ),
    ),
    "a bump in a plane": Family(
        "peaks",
        lambda x, z, m, s, t, a, c, d, w: m + s * x + t * z + a * _peak(x, c, w) * _peak(z, d, w),
        ((-5, 5), (-5, 5), (-5, 5), (0, 10), (0, 1), (0, 1), (0.01, 1)),
        lambda r: (
            _scattered(r, 200, 600, 1),
            [1, 1, -1, U(r, 1, 4), U(r, 0.1, 0.9), U(r, 0.1, 0.9), U(r, 0.05, 0.2)],
            0.3,
        ),
    ),
    "a spot in an image": Family(
        "peaks",
        lambda x, z, m, a, c, d, v, w: m + a * _peak(x, c, v) * _peak(z, d, w),
        ((0, 5), (0, 20), (0, 1), (0, 1), (0.01, 1), (0.01, 1)),
        lambda r: (
            _pixels(r), [1, U(r, 2, 6), U(r, 0.1, 0.9), U(r, 0.1, 0.9), U(r, 0.04, 0.15),
                         U(r, 0.04, 0.15)], 0.4,
        ),
    ),
    "two echoes of one width": Family(
        "peaks",
        lambda t, a, c, b, d, w: a * _peak(t, c, w) + b * _peak(t, d, w),
        ((0, 20), (0, 100), (0, 20), (0, 100), (0.3, 30)),
        lambda r: (
            _even(r, 100, 400, 100),
            [U(r, 2, 5), U(r, 10, 45), U(r, 0.5, 3), U(r, 50, 90), U(r, 1, 4)], 0.2,
        ),
    ),
    "a dip between two steps": Family(
        "peaks",
        lambda x, m, h, c, k, a, d, w: (
            m + h * np.tanh((x - c) / k) - a * _peak(x, d, w)
        ),
        ((-5, 5), (-10, 10), (0, 100), (0.3, 30), (0, 20), (0, 100), (0.3, 30)),
        lambda r: (
            _even(r, 80, 300, 100),
            [1, U(r, 1, 3), U(r, 10, 40), U(r, 1, 6), U(r, 1, 3), U(r, 60, 90), U(r, 1, 5)], 0.2,
        ),
    ),
    "a pulse that rises and decays": Family(
        "peaks",
        lambda t, m, a, s, u, v: (
            m + a * _step((t - s) / 0.5) * (np.exp(-np.maximum(t - s, 0) / v)
                                            - np.exp(-np.maximum(t - s, 0) / u))
        ),
        ((-5, 5), (0, 30), (0, 100), (0.3, 50), (0.3, 100)),
        lambda r: (
            _even(r, 100, 400, 100), [0.5, U(r, 3, 8), U(r, 10, 70), U(r, 0.5, 3), U(r, 5, 15)],
            0.3,
        ),
    ),
    # Periods, whose loss is flat if the curve is out of phase.
    "sine in noise": Family(
        "periods",
        lambda x, c, a, b, T: c + a * np.sin(2 * np.pi * x / T) + b * np.cos(2 * np.pi * x / T),
        ((-10, 10), (-5, 5), (-5, 5), PERIOD),
        lambda r: (_even(r, 40, 200, 100), [3, U(r, 0.5, 1.5), 0.3, U(r, 3, 30)], 1.0),
    ),
    "two sines": Family(
        "periods",
        lambda x, a, T, p, b, S, q: (
            a * np.sin(2 * np.pi * x / T + p) + b * np.sin(2 * np.pi * x / S + q)
        ),
        ((0, 5), (3, 60), PHASE) * 2,
        lambda r: (
            _even(r, 80, 300, 100), [1.5, U(r, 5, 30), 1, U(r, 0.4, 1), U(r, 3, 40), 2], 0.3
        ),
    ),
    "a plane wave": Family(
        "periods",
        lambda x, z, m, a, k, h, p: m + a * np.sin(k * x + h * z + p),
        ((-5, 5), (0, 5), (0, 6), (0, 6), PHASE),
        lambda r: (_scattered(r, 100, 500, 10), [0, 1, U(r, 1, 5), U(r, 1, 5), 1], 0.5),
    ),
    "a damped oscillation": Family(
        "periods",
        lambda x, a, g, h, p, m: m + a * np.exp(-g * x) * np.sin(2 * np.pi * h * x + p),
        ((0, 10), (0, 5), (0.1, 6), PHASE, (-2, 2)),
        lambda r: (_even(r, 60, 300, 10), [2, U(r, 0.1, 0.8), U(r, 0.5, 4), 1, 0], 0.3),
    ),
    "two damped oscillations": Family(
        "periods",
        lambda x, a, g, h, p, b, k, f, q: (
            a * np.exp(-g * x) * np.sin(2 * np.pi * h * x + p)
            + b * np.exp(-k * x) * np.sin(2 * np.pi * f * x + q)
        ),
        ((0, 10), (0, 5), (0.1, 6), PHASE) * 2,
        lambda r: (
            _even(r, 100, 400, 10),
            [2, U(r, 0.1, 0.6), U(r, 0.5, 2), 1, U(r, 0.7, 1.5), U(r, 0.1, 0.6), U(r, 2.3, 4.5), 2],
            0.15,
        ),
    ),
    "a rising tone": Family(
        "periods",
        lambda t, a, f, k, p, m: m + a * np.sin(2 * np.pi * (f * t + k * t**2 / 2) + p),
        ((0, 5), (0.05, 5), (-0.5, 0.5), PHASE, (-2, 2)),
        lambda r: (
            _even(r, 120, 400, 10), [1, U(r, 0.3, 2), U(r, 0.05, 0.3), U(r, 0.5, 5), 0], 0.3
        ),
    ),
    "a transit that returns": Family(
        "periods",
        lambda t, m, a, T, s, w: (
            m - a * _step((np.cos(2 * np.pi * (t - s) / T) - np.cos(np.pi * w / T)) * 40)
        ),
        ((0, 2), (0, 1), (2, 40), (0, 40), (0.3, 10)),
        lambda r: (
            _even(r, 200, 500, 100), [1, U(r, 0.05, 0.2), U(r, 6, 20), U(r, 0, 6), U(r, 0.8, 3)],
            0.02,
        ),
    ),
    "day and week": Family(
        "periods",
        lambda t, m, s, a, T, p, b, S, q: (
            m + s * t + a * np.sin(2 * np.pi * t / T + p) + b * np.sin(2 * np.pi * t / S + q)
        ),
        ((-10, 10), (-0.5, 0.5), (0, 5), (2, 12), PHASE, (0, 5), (12, 80), PHASE),
        lambda r: (
            _even(r, 100, 300, 100),
            [1, 0.02, U(r, 0.5, 1.5), U(r, 3, 10), 1, U(r, 0.7, 2), U(r, 15, 50), 4], 0.4,
        ),
    ),
    # A kink that a parameter moves over the rows: the loss has an optimum between any two rows.
    "a lag with dead time": Family(
        "kinks",
        lambda t, K, T, s: K * (1 - np.exp(-np.maximum(t - s, 0) / T)),
        ((0, 5), (0.05, 20), (0, 19)),
        lambda r: (_even(r, 80, 120, 20), [2, U(r, 0.2, 4), U(r, 1, 12)], 0.2),
    ),
    # So many minima that hardly any bracket returns to one of them.
    "three sines in noise": Family(
        "many minima",
        lambda t, a, f, p, b, g, q, c, h, r: (
            a * np.sin(2 * np.pi * f * t + p) + b * np.sin(2 * np.pi * g * t + q)
            + c * np.sin(2 * np.pi * h * t + r)
        ),
        3 * ((0, 3), (0.05, 2), (0, 6.3)),
        lambda r: (
            [np.sort(r.uniform(0, 20, int(r.integers(80, 200))))],
            [
                U(r, 0.5, 2), U(r, 0.1, 0.4), U(r, 0, 6),
                U(r, 0.5, 2), U(r, 0.6, 1.0), U(r, 0, 6),
                U(r, 0.5, 2), U(r, 1.2, 1.8), U(r, 0, 6),
            ],
            0.3,
        ),
    ),
    # A range in which most optima along the period are near its lower end.
    "a sine of any period": Family(
        "wide periods",
        lambda t, c, a, T, p: c + a * np.cos(2 * np.pi * t / T - p),
        ((-5, 5), (0, 5), (1, 100), PHASE),
        lambda r: (
            [np.sort(r.uniform(0, 60, int(r.integers(40, 150))))],
            [1, U(r, 0.5, 1.5), 1 / U(r, 0.04, 0.8), U(r, 0, 6)], 1.0,
        ),
    ),
    # Parts of different shapes that fit tolerably in each other's place, and lobes of a wavelet.
    "a peak and a step": Family(
        "unlike parts",
        lambda x, m, a, c, w, h, d, k: m + a * _peak(x, c, w) + h * _step((x - d) / k),
        ((-5, 5), (0, 50), (0, 100), (0.2, 40), (-30, 30), (0, 100), (0.3, 30)),
        lambda r: (
            _even(r, 80, 400, 100),
            [0.3, U(r, 2, 8), U(r, 10, 90), _log(r, 1, 8), U(r, -8, 8), U(r, 10, 90),
             _log(r, 0.5, 5)], 0.15,
        ),
    ),
    "two peaks of different shapes": Family(
        "unlike parts",
        lambda x, m, a, c, w, b, d, v: m + a * _peak(x, c, w) + b * _hump(x, d, v),
        ((-5, 5), (0, 50), (0, 100), (0.2, 40), (0, 30), (5, 95), (0.3, 30)),
        lambda r: (
            _even(r, 80, 400, 100),
            [0.3, U(r, 2, 8), U(r, 10, 90), _log(r, 1, 8), U(r, 2, 8), U(r, 10, 90),
             _log(r, 1, 8)], 0.15,
        ),
    ),
    "the lesser of two curves": Family(
        "unlike parts",
        lambda x, v, k, m, s: np.minimum(v * x / (k + x), m + s * x),
        ((0, 50), (0.01, 100), (-20, 20), (-5, 5)),
        lambda r: (
            _even(r, 40, 200, 50), [U(r, 8, 15), U(r, 2, 10), U(r, 4, 6), U(r, -0.02, 0.05)], 0.1
        ),
    ),
    "a wavelet": Family(
        "unlike parts",
        lambda t, a, c, f: (
            a * (1 - 2 * (np.pi * f * (t - c)) ** 2) * np.exp(-((np.pi * f * (t - c)) ** 2))
        ),
        ((-20, 20), (0, 10), (0.05, 20)),
        lambda r: (_even(r, 100, 500, 10), [U(r, 2, 8), U(r, 1, 9), _log(r, 0.3, 4)], 0.15),
    ),
}  # fmt: skip
