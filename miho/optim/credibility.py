"""Whether the best minimum of a search by `MIHOGN` can be trusted, besides agreement."""

from __future__ import annotations

import contextlib

import numpy as np

from miho.optim.evidence import EPSILON, Agreement, in_optimum
from miho.optim.meter import BudgetExhausted, UnusableValueError
from miho.optim.miho_gn_state import MIHOGNSettings, MIHOGNState, at_bound
from miho.optim.oracle import Oracle
from miho.quantities import Array

MOST = 3 / 4
"""Share of the ends with a known loss that a doubtful optimum needs. For wrong optima on families
of peaks and periods (`experiments.check.false_ends`) it was 0.4 to 0.7."""


def credible(
    settings: MIHOGNSettings, state: MIHOGNState, oracle: Oracle, agreement: Agreement
) -> bool:
    """Whether the agreement on the best minimum can be trusted.

    It can if the data determine the minimum and only noise is left. A doubtful minimum needs
    more agreeing ends, most of the ends with a known loss, and a longer search; half of these
    ends are enough if only its residuals have structure. A minimum off the bounds that is
    neither determined nor noise may be a plateau and needs twice as many, by which time starts
    by scale have been drawn from all of DECADES.
    """
    minima, best = state.minima, state.best_minimum
    determined, noise = bool(minima.determined[best]), _leaves_noise(state, oracle)
    if determined and noise:
        return True
    if agreement.agreeing < MOST * (agreement.finished - oracle.meter.starts.dropped):
        return False
    if determined and minima.loss[best] <= oracle.traits.noise:
        return 2 * agreement.agreeing >= settings.doubtful_brackets
    plateau = not (determined or noise or at_bound(minima.x[best]))
    enough = agreement.agreeing >= settings.doubtful_brackets * (1 + plateau)
    return enough and oracle.evaluations >= settings.doubtful_cost * state.best_found_after


def _leaves_noise(state: MIHOGNState, oracle: Oracle) -> bool:
    """Whether the best minimum's loss is at most noise, and its residuals look like noise.

    Untested residuals count as noise.
    """
    loss = float(state.minima.loss[state.best_minimum])
    if loss > oracle.traits.noise or loss <= oracle.traits.resolution:
        return loss <= oracle.traits.resolution
    return not (is_tested(state, oracle) and state.structured)


def is_tested(state: MIHOGNState, oracle: Oracle) -> bool:
    """Whether the residuals at the best minimum have been tested for structure, if needed.

    The test is not needed if the loss alone decides.
    """
    loss = float(state.minima.loss[state.best_minimum])
    already_tested = in_optimum(loss, state.tested, oracle.traits.resolution)
    return already_tested or loss > oracle.traits.noise or loss <= oracle.traits.resolution


def prepare_challenge(state: MIHOGNState, oracle: Oracle) -> None:
    """Test the residuals of an optimum for structure, and prepare the starts of its challenge.

    The first challenge exchanges values of parameters that are alike, the next one starts at the
    neighbours of the optimum. If there are other minima, or a period, every second one from then on
    scans parameters. The others draw some coordinates anew.
    """
    if not state.challenged:
        return
    best = state.best_minimum
    if not is_tested(state, oracle):
        state.structured = structured(oracle, state.theta(state.minima.x[best]))
        state.tested = float(state.minima.loss[best])
        state.challenged = not state.structured
    turn = float(state.minima.loss[best]), state.passed
    if not state.challenged or state.prepared == turn:
        return
    state.near, after = None, state.passed - bool(state.alike)
    if after == 0:
        state.near = _neighbours(state, oracle)
    elif after < 0 or (after % 2 and (state.periods or state.minima.loss.size > 1)):
        from miho.optim.challenges import exchanged, scanned, spectrum

        scan = spectrum if after == 1 and state.periods else scanned
        state.near = (exchanged if after < 0 else scan)(state, oracle)
    state.prepared = turn


def _neighbours(state: MIHOGNState, oracle: Oracle) -> Array | None:
    """The best minimum with one parameter each moved by a standard deviation, (2 d, d).

    In unit coordinates; the other parameters follow as in a profile. None if derivatives are
    missing, if the data do not determine all parameters, or for more than MOST_ROWS rows, which
    leave no room for an optimum between two rows.
    """
    from miho.optim.structure import MOST as MOST_ROWS

    N, best = int(state.level_rows[-1]), state.minima.x[state.best_minimum]
    if N > MOST_ROWS:
        return None
    theta = state.theta(best)
    try:
        J = oracle.jacobian(theta) * np.where(state.box.log, theta, 1.0) * state.box.width
        root = np.linalg.inv(np.linalg.qr(J, mode="r"))
    except (UnusableValueError, np.linalg.LinAlgError):
        return None
    variance = float(state.minima.loss.min()) * N / max(N - state.d, 1)
    with np.errstate(all="ignore"):
        covariance = variance * root @ root.T
        directions = covariance / np.sqrt(np.diag(covariance))[:, None]
    if not np.isfinite(directions).all():
        return None
    return np.asarray(np.clip(best + np.concatenate([directions, -directions]), 0, 1))


def structured(oracle: Oracle, theta: Array) -> bool:
    """Whether residuals at a configuration (d,) have a structure that noise does not have.

    This costs one evaluation, or a fraction of one for many rows, if the problem has `row_inputs`.
    Residuals that cannot be evaluated count as structured.
    """
    inputs, rows = oracle.traits.row_inputs, oracle.traits.rows
    if not inputs:
        return False
    from miho.optim.structure import MOST as MOST_ROWS
    from miho.optim.structure import has_structure

    share = 1.0 if rows is None or rows <= MOST_ROWS else MOST_ROWS / rows
    try:
        residuals = oracle.residuals(theta, share)
    except UnusableValueError:
        return True
    order = oracle.traits.order if share < 1 else None
    return has_structure(inputs, residuals, order, oracle.traits.row_parts)


def solves(state: MIHOGNState, oracle: Oracle) -> bool:
    """Whether the best new minimum solves a system of equations, up to rounding.

    Costs one evaluation of residuals and derivatives if the loss is rounding relative to the
    first loss of the run.
    """
    new = state.minima.loss[state.judged :]
    if oracle.traits.rounding > 0 or not new.size or new.min() > EPSILON * oracle.trace.loss[0]:
        return False
    x = state.box.origin + state.box.width * state.minima.x[state.judged + np.argmin(new)]
    theta = state.space.decode(x)
    if not oracle.affords(oracle.traits.jacobian_cost + 1):
        raise BudgetExhausted
    from miho.optim.zero import is_zero

    zero = False
    with contextlib.suppress(UnusableValueError):
        J = oracle.jacobian(theta) * np.where(state.box.log, theta, 1.0)
        zero = is_zero(oracle.residuals(theta, goes_on=True), J, x, state.space)
    state.judged = state.minima.loss.size
    return zero
