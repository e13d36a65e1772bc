"""Streams of rows with known truth, and the tire whose grip changes while it is driven.

A stream has all that an online method needs to start, the rows that it receives, and the true
values of the parameters in each row for the score.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from miho.data import Dataset
from miho.identification import CurveFit
from miho.optim import Parameter, Space
from miho.quantities import Array
from miho.validate import one_of
from miho.vehicle.models import Pacejka

STEP = 0.02
"""Time between two rows, s."""
NOMINAL = np.array([12.0, 1.6, 4000.0, -0.005, 60.0])
"""B [1/rad], C [-], D [N], Sx [rad] and Sy [N] of the tire; the peak is at 0.124 rad."""
OFFLINE = np.array([0.6, 0.064, 120.0, 0.003, 60.0])
"""Standard deviations of the offline estimate of these parameters."""
FORCE_NOISE, SLIP_NOISE = 120.0, 0.0005
"""Standard deviations of the measured force [N] and slip angle [rad]."""
NEAR_PEAK = (0.125, 0.02)
"""Middle and amplitude [rad] of the slip angle while the grip falls suddenly."""
KINDS = (
    "none", "jump", "ramp", "straight", "mixed", "outliers", "jump_outliers", "stiffness",
    "nan", "dropout", "missing", "frozen", "delay", "glitch", "time",
)  # fmt: skip
SUDDEN = ("jump", "jump_outliers", "stiffness")


@dataclass(frozen=True, eq=False)
class Stream:
    """Rows of measurements with the true parameters.

    Parameters
    ----------
    kind : str
        Name of the change or fault.
    problem : sequence of CurveFit
        Model, bounds and noise of each output.
    prior : mapping of str to (float, float)
        Offline estimate and standard deviation of each parameter.
    changes : mapping of str to float
        The parameters that may jump, and by which share.
    input_noise : mapping of str to float
        Standard deviations of measured inputs.
    columns : mapping of str to ndarray of shape (N,)
        The measurements, with a column `time` [s].
    truth : mapping of str to ndarray of shape (N,)
        The true parameters in each row.
    clock : ndarray of shape (N,)
        True time of each row [s]; the column `time` may be wrong.
    start, end : float, optional
        Times [s] between which the parameters change, or between which a fault lasts.
    """

    kind: str
    problem: Sequence[CurveFit]
    prior: Mapping[str, tuple[float, float]]
    changes: Mapping[str, float]
    input_noise: Mapping[str, float]
    columns: Mapping[str, Array]
    truth: Mapping[str, Array]
    clock: Array
    start: float | None = None
    end: float | None = None

    def __len__(self) -> int:
        return len(self.columns["time"])

    def __iter__(self) -> Iterator[dict[str, float]]:
        names = tuple(self.columns)
        for row in zip(*(column.tolist() for column in self.columns.values()), strict=True):
            yield dict(zip(names, row, strict=True))

    def during(self, start: float, end: float = np.inf) -> NDArray[np.bool_]:
        """Mask (N,) of the rows from one true time to another [s]."""
        return (self.clock >= start - STEP / 2) & (self.clock < end - STEP / 2)


def tire(
    kind: str, seed: int, seconds: float = 60.0, at: float = 30.0, drop: float = 0.35
) -> Stream:
    """Return a stream of lateral force over slip angle at 50 Hz.

    The slip angle follows corners of 2 to 6 s, half of them gentle (0.02 to 0.05 rad) and half
    near the peak (0.10 to 0.16 rad). Each seed has its own tire and its own error of the offline
    estimate.

    Parameters
    ----------
    kind : str
        "none" is no change. D falls within 0.2 s ("jump", "jump_outliers") or within 10 s ("ramp");
        B falls within 0.2 s ("stiffness"). "straight" has a slip angle of 0.002 rad from `at`,
        "mixed" in 60 of every 150 s. Faults: 2 % of the forces are off by 20 standard deviations
        ("outliers"); a tenth of the values is NaN ("nan"); from `at`, for 5 s, the force is NaN
        ("dropout"), there are no rows ("missing"), or the force repeats one value ("frozen");
        the slip angle arrives one row late ("delay"), or three rows in 2 s have a threefold one
        ("glitch");
        the time jumps ahead by 10 s at `at`, and back by 5 s 5 s later ("time").
    seed : int
        Seed of the tire, the drive and the noise.
    seconds : float, optional
        Length of the stream.
    at : float, optional
        Time of the change or fault [s].
    drop : float, optional
        Share by which D or B falls.

    Returns
    -------
    Stream
        The rows with `alpha` [rad], `Fy` [N] and `time` [s].

    Raises
    ------
    ValueError
        If the kind is unknown.

    Examples
    --------
    >>> stream = tire("jump", seed=1)
    >>> len(stream), round(float(stream.truth["D"][-1] / stream.truth["D"][0]), 2)
    (3000, 0.65)
    """
    one_of("kind", kind, KINDS)
    rng = np.random.default_rng(seed)
    t = np.asarray(STEP * np.arange(round(seconds / STEP)), dtype=float)
    theta = NOMINAL * (1 + 0.1 * rng.uniform(-1, 1, 5))
    estimate = theta + OFFLINE * rng.standard_normal(5)
    slip = corners(rng, t.size)
    sudden = kind in SUDDEN
    if sudden:
        swing_near_peak(slip, t, at, rng, NEAR_PEAK)
    straighten(slip, t, kind, at, rng)
    fall = 1 - drop * np.clip((t - at) / (0.2 if sudden else 10.0), 0, 1)
    rows = np.tile(theta, (t.size, 1))
    if sudden or kind == "ramp":
        rows[:, 0 if kind == "stiffness" else 2] *= fall
    B, C, D, Sx, Sy = rows.T
    force = D * np.sin(C * np.arctan(B * (Sx + slip))) + Sy
    force += FORCE_NOISE * rng.standard_normal(t.size)
    alpha = -slip + SLIP_NOISE * rng.standard_normal(t.size)
    columns = {"time": t.copy(), "alpha": alpha, "Fy": force}
    spoil(columns, ("Fy",), (FORCE_NOISE,), kind, at, rng)
    names = tuple(Pacejka.parameters)
    there = present(t, kind, at)
    return Stream(
        kind,
        (tire_problem(estimate),),
        {n: (float(v), float(s)) for n, v, s in zip(names, estimate, OFFLINE, strict=True)},
        {"B": 0.35, "D": 0.35} if kind == "stiffness" else {"D": 0.35},
        {"alpha": SLIP_NOISE},
        {name: column[there] for name, column in columns.items()},
        {name: column[there] for name, column in zip(names, rows.T, strict=True)},
        t[there],
        *period(kind, at),
    )


def tire_problem(estimate: Array) -> CurveFit:
    """Return the fit of the tire; its rows are the offline estimate's forces up to 0.16 rad.

    `estimate` (5,) is B, C, D, Sx, Sy.
    """
    low = np.array([3.6, 0.96, 200.0, -0.03, -600.0])
    high = np.array([36.0, 2.4, 8000.0, 0.03, 600.0])
    alpha = np.linspace(-0.16, 0.16, 65)
    force = Pacejka().predict(estimate[None], alpha)[0]
    data = Dataset("tire", {"alpha": alpha, "Fy": force}, {"alpha": "rad", "Fy": "N"}, "Fy")
    return CurveFit(Pacejka(), data, space_of(Pacejka.parameters, low, high), sigma=FORCE_NOISE)


def space_of(units: Mapping[str, str], low: Array, high: Array) -> Space:
    """Return the space of parameters with these units by name, and these bounds."""
    bounds = zip(units.items(), low, high, strict=True)
    return Space(tuple(Parameter(name, unit, lo, hi) for (name, unit), lo, hi in bounds))


def space_about(units: Mapping[str, str], nominal: Array) -> Space:
    """Return the space from 0.2 to 3 times the nominal value of each parameter."""
    return space_of(units, 0.2 * nominal, 3 * nominal)


def corners(rng: np.random.Generator, rows: int) -> Array:
    """Return slip angles [rad] (rows,) of corners of 2 to 6 s, half of them near the peak."""
    slip = np.zeros(rows)
    k = 0
    while k < rows:
        length = int(rng.uniform(2, 6) / STEP)
        high = rng.uniform(0.10, 0.16) if rng.random() < 0.5 else rng.uniform(0.02, 0.05)
        corner = high * np.sin(np.pi * np.arange(length) / length) ** 0.7
        slip[k : k + length] = (rng.choice([-1, 1]) * corner)[: rows - k]
        k += length
    phase = rng.uniform(0, 6)
    return np.asarray(slip + 0.004 * np.sin(2 * np.pi * 1.3 * STEP * np.arange(rows) + phase))


def swing_near_peak(
    slip: Array, t: Array, at: float, rng: np.random.Generator, swing: tuple[float, float]
) -> None:
    """Set the slip angle near the peak from 1 s before the change until 3 s after it.

    Slip angles (N,) [rad] change in place; `swing` is their middle and their amplitude [rad].
    """
    near = (t >= at - 1) & (t < at + 3)
    slip[near] = swing[0] + swing[1] * np.sin(2 * np.pi * 1.1 * t[near] + rng.uniform(0, 6))


def straighten(slip: Array, t: Array, kind: str, at: float, rng: np.random.Generator) -> None:
    """Set the slip angle (N,) [rad] to noise of 0.002 rad on the straights of a stream."""
    straight = is_straight(kind, t, at)
    slip[straight] = 0.002 * rng.standard_normal(np.count_nonzero(straight))


def is_straight(kind: str, t: Array, at: float = 0.0) -> NDArray[np.bool_]:
    """Return the mask (N,) of the rows on straights, for a kind of `tire`."""
    if kind == "mixed":
        return np.asarray(t % 150 > 90)
    return np.asarray(t >= at) if kind == "straight" else np.full(t.size, False)


def spoil(
    columns: dict[str, Array],
    outputs: Sequence[str],
    noise: Sequence[float],
    kind: str,
    at: float,
    rng: np.random.Generator,
) -> None:
    """Change the measured columns in place as a kind of fault of `tire` says.

    `noise` is the standard deviation of the noise of each output.
    """
    t = columns["time"].copy()
    fault = (t >= at) & (t < at + 5)
    if kind.endswith("outliers"):
        bad = rng.random(t.size) < 0.02
        sign = rng.choice([-1, 1], np.count_nonzero(bad))
        for name, sigma in zip(outputs, noise, strict=True):
            columns[name][bad] += 20 * sigma * sign
    if kind == "nan":
        for name in [name for name in columns if name != "time"]:
            columns[name][rng.random(t.size) < 0.1] = np.nan
    for name in outputs:
        if kind == "dropout":
            columns[name][fault] = np.nan
        if kind == "frozen":
            columns[name][fault] = columns[name][fault][0]
    for name in [name for name in columns if name not in ("time", *outputs)]:
        if kind == "delay":
            columns[name][1:] = columns[name][:-1].copy()
        if kind == "glitch":
            columns[name][(t >= at) & (np.arange(t.size) % 100 < 3)] *= 3
    if kind == "time":
        columns["time"] += 10.0 * (t >= at) - 5.0 * (t >= at + 5)


def present(t: Array, kind: str, at: float) -> NDArray[np.bool_]:
    """Return the mask (N,) of the rows that arrive, for a kind of `tire`."""
    return (t < at) | (t >= at + 5) if kind == "missing" else np.full(t.size, True)


def period(kind: str, at: float) -> tuple[float | None, float | None]:
    """Return start and end [s] of a change or a fault of `tire`.

    Both are None for a kind that lasts all the time, or for none.
    """
    seconds = {"ramp": 10.0, "dropout": 5.0, "missing": 5.0, "frozen": 5.0, "time": 5.0}
    if kind in SUDDEN:
        return at, at + 0.2
    return (at, at + seconds[kind]) if kind in seconds else (None, None)
