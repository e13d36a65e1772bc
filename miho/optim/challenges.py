"""Starts of challenges to the best minimum, which has most parameters right."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from miho.optim.miho_gn_state import MIHOGNState
from miho.optim.oracle import Oracle
from miho.quantities import Array

SHARE, MOST_POINTS, FEWEST_POINTS, MOST_STARTS, EXCHANGES = 1 / 8, 32, 4, 3, 4
"""Largest share of the evaluations so far that a scan costs, largest and smallest number of points
along a parameter, largest number of starts, and number of exchanges."""
AT_ONCE = 1 << 15
"""Largest number of residuals of a scan that are evaluated at once, unless a point has more."""
GOLDEN = (5**0.5 - 1) / 2


def exchanged(state: MIHOGNState, oracle: Oracle) -> Array | None:
    """Starts (k, d) at the best minimum with values exchanged among parameters, the best first.

    A minimum may have the parameters of one peak at another one. Values of parameters that are
    `alike` are exchanged, in every second start in the same way for position and width, in the
    first one in reverse order. The linear parameters are solved for.
    """
    box, rng = state.box, np.random.default_rng(state.bracket)  # repeatable
    best = box.origin + box.width * state.minima.x[state.best_minimum]
    starts, keys = np.tile(best, (EXCHANGES, 1)), rng.random((EXCHANGES, best.size))
    for group in state.alike:
        group_keys = keys[:, group]
        group_keys[::2] = keys[::2, : len(group)]
        starts[:, group] = best[group][np.argsort(group_keys, axis=1)]
        starts[0, group] = best[group[::-1]]
    starts = np.where((starts == best).all(axis=1, keepdims=True), starts[0], starts)
    x = np.clip((starts - box.origin) / box.width, 0.0, 1.0)
    return _lowest(x, _losses(x, state, oracle))


def scanned(state: MIHOGNState, oracle: Oracle) -> Array | None:
    """Lowest points of the loss along each parameter through the best minimum, (k, d).

    Each is a minimum among evenly spaced values of one parameter, apart from the best minimum, in
    unit coordinates. Parameters in which the model is linear are left out. The values differ
    between scans. None if there is no such point, or if the search is too short for a scan.
    """
    best, scans = state.minima.x[state.best_minimum], state.box.nonlinear
    cost = scans.size * (state.box.linear.size + 1)
    n = min(MOST_POINTS, int(SHARE * state.spent_before / cost))
    if n < FEWEST_POINTS:
        return None
    points = _spaced(n, state)
    x = np.tile(best, (scans.size, n, 1))
    x[np.arange(scans.size), :, scans] = points
    x = x.reshape(-1, best.size)
    losses = _losses(x, state, oracle).reshape(scans.size, n)
    apart = [_apart(points, best[k]) for k in scans]
    return _lowest(x, np.where(_low(losses) & apart, losses, np.inf).ravel())


def spectrum(state: MIHOGNState, oracle: Oracle) -> Array | None:
    """Lowest points of the loss along each parameter of a period, (k, d).

    As `scanned`, but values are a period apart and each has several phases, as in a periodogram.
    Values are farther apart if the scan would cost more than the search so far.
    """
    best, periods = state.minima.x[state.best_minimum], state.periods
    cost = sum(period.passed[-1] * len(period.turns) for period in periods.values())
    most = state.spent_before / (state.box.linear.size + 1)
    lines, lowest = [], []
    for k, period in periods.items():
        points = period.at(_spaced(int(min(1.0, most / cost) * period.passed[-1]), state))
        line = np.tile(best, (points.size, 1))
        line[:, k] = points
        lines.append(np.stack([period.turned(line, turn) for turn in period.turns]))
    x = np.concatenate([line.reshape(-1, best.size) for line in lines])
    losses = solve_linear(x, state, oracle)
    ends = np.cumsum([line.shape[0] * line.shape[1] for line in lines])[:-1]
    for k, line, values in zip(periods, lines, np.split(losses, ends), strict=True):
        turned = values.reshape(line.shape[:2])
        low = _low(turned.min(axis=0)) & _apart(line[0, :, k], best[k])
        low = low & (np.arange(len(turned))[:, None] == turned.argmin(axis=0))
        lowest.append(np.where(low, turned, np.inf).ravel())
    return _lowest(x, np.concatenate(lowest))


def _losses(x: Array, state: MIHOGNState, oracle: Oracle) -> Array:
    """Losses (n,) at points x (n, d) after a solution for their linear parameters, if any."""
    if state.box.linear.size:
        return solve_linear(x, state, oracle)
    return np.asarray(oracle(_thetas(x, state)))


def solve_linear(x: Array, state: MIHOGNState, oracle: Oracle) -> Array:
    """Losses (n,) at points x (n, d) after a solution for their linear parameters, set in x.

    Points and residuals that an interrupted scan has evaluated are kept in the state.
    """
    box, scan, linear = state.box, state.scan, state.box.linear
    theta, low, width = _thetas(x, state), box.low[linear], (box.high - box.low)[linear]
    shares = (theta[:, linear] - low) / width  # of the ranges, also on the log scale
    far = np.where(shares <= 0.5, 1.0, 0.0)  # wide differences are more accurate
    probes = np.repeat(x[:, None], linear.size + 1, axis=1)
    probes[:, np.arange(linear.size) + 1, linear] = far
    thetas, each = _thetas(probes.reshape(-1, x.shape[1]), state), linear.size + 1
    if oracle.workers.spreads:
        known = len(scan.solved) * each + len(scan.residuals)
        oracle.workers.ahead(thetas[known:], kind="residuals")
    batch = max(each, AT_ONCE // max(1, int(state.level_rows[-1])))
    for k in range(len(scan.solved), len(x)):
        while len(scan.residuals) < each:
            place = k * each + len(scan.residuals)
            scan.residuals.extend(oracle.residual_rows(thetas[place : place + batch]))
        scan.solved.append(_solution(scan.residuals[:each], shares[k], far[k]))
        del scan.residuals[:each]
    losses = np.array([loss for loss, _ in scan.solved])
    solved = np.reshape([solution for _, solution in scan.solved], far.shape)
    scan.solved.clear()
    theta[:, linear] = low + width * solved
    coordinates = (state.space.encode(theta) - box.origin) / box.width
    x[:, linear] = np.clip(coordinates, 0.0, 1.0)[:, linear]
    return losses


def _solution(residuals: Sequence[Array], values: Array, ends: Array) -> tuple[float, Array]:
    """Smallest loss over the linear parameters, and where it is in their ranges, (p,).

    `residuals` (p + 1, N) are at the `values` (p,), and with one parameter each at its end (p,).
    """
    if not all(row.size and np.isfinite(row).all() for row in residuals):
        return math.inf, values
    with np.errstate(over="ignore", invalid="ignore"):
        columns = (np.array(residuals)[1:] - residuals[0]).T / (ends - values)
        if not np.isfinite(columns).all():
            return math.inf, values
        solution = np.clip(values - np.linalg.lstsq(columns, residuals[0])[0], 0.0, 1.0)
        loss = float(np.mean((residuals[0] + columns @ (solution - values)) ** 2))
    return loss if math.isfinite(loss) else math.inf, solution


def _spaced(n: int, state: MIHOGNState) -> Array:
    """Evenly spaced shares (n,) of a range, which differ from bracket to bracket."""
    return (np.arange(n) + state.bracket * GOLDEN % 1) / n


def _apart(points: Array, best: float) -> NDArray[np.bool_]:
    """Whether points (n,) are apart from the best minimum; its two neighbours lead back to it."""
    apart = np.ones(points.size, bool)
    after = int(np.searchsorted(points, best))
    apart[max(after - 1, 0) : after + 1] = False
    return apart


def _low(losses: Array) -> NDArray[np.bool_]:
    """Whether losses (..., n) are lower than both neighbours."""
    outside = np.full((*losses.shape[:-1], 1), np.inf)
    sides = np.concatenate([outside, losses, outside], axis=-1)
    return np.asarray((losses < sides[..., :-2]) & (losses < sides[..., 2:]))


def _lowest(x: Array, losses: Array) -> Array | None:
    """Points of x (n, d) with the lowest finite losses (n,); None if there are none."""
    order = np.argsort(losses, kind="stable")[:MOST_STARTS]
    order = order[np.isfinite(losses[order])]
    return x[order] if order.size else None


def _thetas(x: Array, state: MIHOGNState) -> Array:
    """Parameters in units (n, d) at unit coordinates x (n, d)."""
    return state.space.decode(state.box.origin + state.box.width * x)
