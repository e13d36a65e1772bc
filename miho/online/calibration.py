"""The scale of intervals and the threshold of the alarm from a record without a change."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.online.rules import Rules
from miho.online.slopes import RowFormula
from miho.online.state import TrackerState
from miho.quantities import Array

LEVEL, QUANTILE = 0.95, 1.959964
BLOCK, LEAST = 50, 20
"""Rows of a block, and least number of blocks."""
MARGIN = 1.0
"""Distance of the threshold from the largest odds, which are logarithms."""
STEPS = 5
"""Gauss-Newton steps of the fit of a record."""
FAR = 3.0
"""Errors count as at most this number of standard deviations."""


class Calibration(NamedTuple):
    """The calibration of a tracker by a quiet record.

    Parameters
    ----------
    scale : float
        Factor of the intervals.
    threshold : float
        Logarithm of the odds that raise the alarm.
    """

    scale: float
    threshold: float


class RecordFit(NamedTuple):
    """The best fit of a record.

    Attributes
    ----------
    theta : ndarray, shape (d,)
        Parameters.
    variances : ndarray, shape (d,)
        Their variances, which allow for errors that depend on each other.
    """

    theta: Array
    variances: Array


def calibration(
    states: Sequence[TrackerState], best: RecordFit, watched: NDArray[np.bool_], threshold: float
) -> Calibration:
    """Return the calibration from the states of a quiet record and the best fit of the record.

    The best fit uses the same record, so its variance is added to the squared distance between it
    and an estimate. The scale is a ratio of root mean squares, the largest one of all watched
    parameters.

    Parameters
    ----------
    states : sequence of TrackerState
        State after each row of the record; the first quarter does not count for the scale.
    best : RecordFit
        Best fit of the record.
    watched : ndarray of bool, shape (d,)
        Whether the alarm watches each parameter.
    threshold : float
        Least threshold of the alarm.

    Returns
    -------
    Calibration
        Scale and threshold.

    Raises
    ------
    ValueError
        If the record does not inform a watched parameter.
    """
    settled = states[len(states) // 4 :]
    informed = np.array([state.identifiable & watched for state in settled])
    if not informed.any():
        raise ValueError(
            f"calibrate: {len(states)} rows inform none of the watched parameters; expected a "
            "record in which they act"
        )
    squares = np.array([(state.theta - best.theta) ** 2 + best.variances for state in settled])
    reach = np.array([np.diff(state.intervals(LEVEL))[:, 0] / 2 for state in settled])
    stated = np.maximum(reach / QUANTILE, np.finfo(float).tiny) ** 2
    odds = max(state.odds for state in states)
    shares = [
        np.mean(column[own])
        for column, own in zip((squares / stated).T, informed.T, strict=True)
        if own.any()
    ]
    scale = float(np.sqrt(max(shares)))
    return Calibration(scale, max(threshold, odds + MARGIN))


def fitted_to(
    rows: Array, formula: RowFormula, rules: Rules, theta: Array, covariance: Array
) -> RecordFit:
    """Fit parameters to all rows of a record and to a prior.

    Errors may depend on each other within blocks of rows: variances are from the scatter of the
    blocks' scores (Newey and West, Econometrica 55, 1987, with a rectangular window).

    Parameters
    ----------
    rows : ndarray, shape (n, p + m + 1)
        Inputs, outputs and time of each row.
    formula : RowFormula
        Outputs and derivatives of a row.
    rules : Rules
        Noise, bounds and units of the parameters.
    theta : ndarray, shape (d,)
        Mean of the prior.
    covariance : ndarray, shape (d, d)
        Covariance of the prior.

    Returns
    -------
    RecordFit
        The best fit.

    Raises
    ------
    ValueError
        If there are fewer than 20 blocks.
    """
    if len(rows) < LEAST * BLOCK:
        raise ValueError(f"calibrate: {len(rows)} rows; expected at least {LEAST * BLOCK}")
    prior = np.linalg.inv(covariance / np.outer(rules.unit, rules.unit))
    best = theta.copy()
    for _ in range(STEPS):
        each = [_of_row(row, formula, rules, best) for row in rows]
        information = prior + sum(more for more, _ in each)
        scores = np.array([score for _, score in each])
        pull = prior @ ((theta - best) / rules.unit) + scores.sum(axis=0)
        step = rules.unit * np.linalg.solve(information, pull)
        best = np.clip(best + step, rules.low, rules.high)
    blocks = scores[: len(scores) // BLOCK * BLOCK].reshape(-1, BLOCK, theta.size).sum(axis=1)
    moves = np.linalg.solve(information, (blocks - blocks.mean(axis=0)).T)
    return RecordFit(best, rules.unit**2 * np.sum(moves**2, axis=1))


def _of_row(row: Array, formula: RowFormula, rules: Rules, theta: Array) -> tuple[Array, Array]:
    """Information (d, d) and score (d,) of a row; missing outputs contribute 0."""
    m = rules.sigma.size
    inputs, outputs = row[: -1 - m], row[-1 - m : -1]
    slopes = formula.at(theta[None], inputs[None])
    J = slopes.parameters[:, 0] * rules.unit
    variance = rules.sigma**2 + np.sum((slopes.inputs[:, 0] * rules.noise) ** 2, axis=1)
    errors = (outputs - slopes.values[:, 0]) / np.sqrt(variance)
    good = np.isfinite(errors) & np.isfinite(J).all(axis=1)
    J = J[good] / np.sqrt(variance[good, None])
    return J.T @ J, J.T @ np.clip(errors[good], -FAR, FAR)
