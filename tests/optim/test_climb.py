"""Steps in the machine against the general path: the same bits, wherever a run is cut."""

from __future__ import annotations

import math
import pickle
import signal
from dataclasses import dataclass, replace
from itertools import count
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from miho import (
    MIHO,
    AskTell,
    Budget,
    CurveFit,
    Dataset,
    Oracle,
    Parameter,
    Problem,
    Space,
    minimize,
)
from miho.compiled import Block, Climb, Kernel, Rows, Steps
from miho.compiled.kernel import Formula
from miho.compiled.taped import TapedLoss
from miho.core import machine
from miho.models.expression import Expression
from miho.optim import BudgetExhausted, Clock, Outcome, RunRecord
from miho.optim.miho import climb_of
from miho.optim.schedule import hyperband_table
from miho.optim.seeds import stream
from miho.vehicle.models import TorqueCubic

Array = NDArray[np.float64]

pytestmark = pytest.mark.skipif(machine() is None, reason="the machine was not built")

BOX = [(-50, 150), (-200, 400), (-400, 200), (-200, 200)]


def space_of(model: Expression, box: list[tuple[float, float]]) -> Space:
    units = model.parameters.items()
    return Space(tuple(Parameter(n, u, *ends) for (n, u), ends in zip(units, box, strict=True)))


SPACE = space_of(TorqueCubic(), BOX)


def taped(model: Expression, x: Array, y: Array, order: NDArray[np.intp]) -> TapedLoss:
    """The mean square of a formula of one input minus y (N,) at x (N,)."""
    tapes = model.tapes
    assert tapes is not None
    return TapedLoss(*tapes, x[None], y, order)


def torque(rows: int = 150) -> TapedLoss:
    """The loss of a noisy torque curve."""
    rng = np.random.default_rng(5)
    omega = rng.uniform(100, 730, rows)
    w = omega / TorqueCubic().omega_max
    y = 40 + 150 * w - 90 * w**2 - 20 * w**3 + rng.normal(0, 10, rows)
    return taped(TorqueCubic(), omega, y, rng.permutation(rows))


class Counting(NamedTuple):
    """A kernel of counted steps."""

    climb: Climb
    rows: Rows | None = None


@dataclass
class Watched(Problem):
    """A problem that counts its compiled steps, or has none.

    Beyond `until` steps somebody presses Ctrl-C.
    """

    fit: TapedLoss
    compiled: bool = True
    space: Space = SPACE
    until: float = math.inf
    steps: int = 0
    name: str = "climbed"

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        return self.fit.losses(thetas)

    @property
    def kernel(self) -> Kernel | None:
        return Counting(self._climb) if self.compiled else None

    def _climb(self, steps: Steps, best: float, target: float) -> Block:
        block = self.fit.climb(steps, best, target)
        self.steps += round(block.evaluations) // len(steps.P)
        if self.steps > self.until:
            signal.raise_signal(signal.SIGINT)
        return block


@pytest.fixture(scope="module")
def fit() -> TapedLoss:
    return torque()


def both(
    fit: TapedLoss,
    optimizer: MIHO,
    budget: Budget | None = None,
    seed: int = 3,
    space: Space = SPACE,
) -> tuple[RunRecord, RunRecord]:
    """The run with steps of the machine, and the one without."""
    watched = Watched(fit, space=space)
    climbed = minimize(optimizer, watched, budget, seed)
    assert watched.steps > 1
    return climbed, minimize(optimizer, Watched(fit, False, space), budget, seed)


def same(record: RunRecord, reference: RunRecord) -> None:
    """Outcome, count, best and every improvement, bit for bit."""
    assert record.outcome is reference.outcome, record.error or reference.error
    assert record.evaluations == reference.evaluations
    assert record.loss == reference.loss
    assert record.trace.evaluations == reference.trace.evaluations
    assert record.trace.loss == reference.trace.loss
    assert np.array_equal(record.trace.theta, reference.trace.theta)
    assert len(record.trace) > 3
    assert record.trace.seconds == sorted(record.trace.seconds)


@pytest.mark.parametrize("early_stopping", [False, True])
@pytest.mark.parametrize("clip", ["box", "lower", "none"])
@pytest.mark.parametrize("annealing", ["linear", "exponential"])
def test_the_trace_is_that_of_the_general_path(
    fit: TapedLoss, early_stopping: bool, clip: str, annealing: str
) -> None:
    optimizer = MIHO(R=100, eta=3, clip=clip, annealing=annealing, early_stopping=early_stopping)
    climbed, general = both(fit, optimizer)
    same(climbed, general)
    assert climbed.outcome is Outcome.CONVERGED
    assert climbed.rejected == general.rejected == {}


@pytest.mark.parametrize(("R", "eta"), [(1, 2), (2, 2), (3, 3), (5, 2), (400, 20)])
def test_small_schedules(fit: TapedLoss, R: int, eta: int) -> None:
    runs = [
        minimize(MIHO(R=R, eta=eta), Watched(fit, compiled), seed=1) for compiled in (True, False)
    ]
    assert runs[0].trace.loss == runs[1].trace.loss
    assert runs[0].evaluations == runs[1].evaluations
    assert np.array_equal(runs[0].trace.theta, runs[1].trace.theta)


@pytest.mark.parametrize("early_stopping", [False, True])
@pytest.mark.parametrize("evaluations", [1, 80, 81, 100, 163, 250, 333, 401, 600, 777])
def test_cut_anywhere_and_resumed_from_a_pickle(
    fit: TapedLoss, evaluations: int, early_stopping: bool
) -> None:
    """MIHO(81, 3) starts with 81 configurations; later budgets end inside a step of several."""
    optimizer = MIHO(R=81, eta=3, early_stopping=early_stopping)
    whole = minimize(optimizer, Watched(fit, False), Budget(evaluations=900), 3)
    for compiled in (True, False):
        cut = minimize(optimizer, Watched(fit, compiled), Budget(evaluations=evaluations), 3)
        assert cut.evaluations == evaluations
        assert cut.outcome is Outcome.BUDGET
        improvements = [n for n in whole.trace.evaluations if n <= evaluations]
        assert cut.trace.evaluations == improvements
        checkpoint = pickle.loads(pickle.dumps(cut.checkpoint))
        for goes_on in (True, False):
            resumed = minimize(optimizer, Watched(fit, goes_on), Budget(evaluations=900), 3,
                               checkpoint=checkpoint)  # fmt: skip
            same(resumed, whole)


def test_a_target_ends_the_run_at_the_same_improvement(fit: TapedLoss) -> None:
    optimizer = MIHO(R=100, eta=3)
    losses = minimize(optimizer, Watched(fit), seed=3).trace.loss
    for target in (losses[-3], losses[len(losses) // 2]):
        climbed, general = both(fit, optimizer, Budget(target=target))
        assert climbed.outcome is general.outcome is Outcome.BUDGET
        at = losses.index(target)
        assert climbed.trace.loss[at] == general.trace.loss[at] == target
        assert climbed.trace.evaluations[at] == general.trace.evaluations[at]
        assert climbed.evaluations - climbed.trace.evaluations[at] < 100
        resumed = [minimize(optimizer, Watched(fit), seed=3, checkpoint=run.checkpoint)
                   for run in (climbed, general)]  # fmt: skip
        same(*resumed)
        assert resumed[0].trace.loss == losses


def test_a_target_in_the_last_step_is_still_what_ended_the_run(fit: TapedLoss) -> None:
    optimizer = MIHO(R=5, eta=2)
    last = hyperband_table(5, 2, "ceil")[-1].n
    runs = (minimize(optimizer, Watched(fit), seed=seed) for seed in range(200))
    seed, free = next(
        (seed, run) for seed, run in enumerate(runs)
        if run.evaluations - run.trace.evaluations[-1] < last
    )  # fmt: skip
    climbed, general = both(fit, optimizer, Budget(target=free.loss), seed)
    assert climbed.outcome is general.outcome is Outcome.BUDGET
    assert climbed.loss == general.loss == free.loss


def test_log_scales_go_the_general_path() -> None:
    fit = torque()
    units = {"omega": "rad/s", "T": "Nm"}
    data = Dataset("torque", {"omega": fit.X[0], "T": fit.y}, units, "T")
    first = Parameter("p0", "Nm", 1, 150, "log")
    log = CurveFit(TorqueCubic(), data, Space((first, *SPACE.parameters[1:])))
    assert climb_of(Oracle(log, Budget())) is None
    assert climb_of(Oracle(CurveFit(TorqueCubic(), data, SPACE), Budget())) is not None
    record = minimize(MIHO(R=30, eta=3), log)
    assert record.outcome is Outcome.CONVERGED
    assert record.loss < 1000


def test_fresh_proposals_go_the_general_path(fit: TapedLoss) -> None:
    watched = Watched(fit)
    minimize(MIHO(R=100, eta=3, proposal="fresh"), watched)
    assert watched.steps == 0


def climb_by(fit: TapedLoss, P: Array, L: Array, noise: Array, early_stopping: bool) -> Block:
    """Mutations of P by the rows of `noise`, against the incumbents L."""
    sigma, bounds = np.ones((len(noise), P.shape[1])), SPACE.bounds
    first = np.clip(P + noise[0], *bounds)
    steps = Steps(first, P, L, noise[1:], sigma[1:], bounds, early_stopping)
    return fit.climb(steps, math.inf, -math.inf)


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1), rows=st.sampled_from([1, 63, 64, 65, 200, 1500]),
       size=st.floats(1e-6, 100))  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_early_stopping_changes_no_decision(seed: int, rows: int, size: float) -> None:
    fit, rng = FITS[rows], np.random.default_rng(seed)
    results = []
    P = SPACE.sample(4, rng)
    L, noise = fit.losses(P), size * rng.standard_normal((10, *P.shape))
    L[0], L[1] = np.inf, fit.losses(np.clip(P + noise[0], *SPACE.bounds))[1]
    for early_stopping in (False, True):
        p, losses = P.copy(), L.copy()
        block = climb_by(fit, p, losses, noise, early_stopping)
        results.append((p.tolist(), losses.tolist(), block.at.tolist(), block.losses.tolist(),
                      block.thetas.tolist(), block.evaluations))  # fmt: skip
    assert results[0] == results[1]
    assert results[0][5] == 10 * len(P)


FITS = {rows: torque(rows) for rows in (1, 63, 64, 65, 200, 1500)}


def test_an_equal_loss_does_not_replace_its_parent(fit: TapedLoss) -> None:
    P = SPACE.initial(3)
    for early_stopping in (False, True):
        p, L = P.copy(), fit.losses(P)
        block = climb_by(fit, p, L, np.zeros((5, *P.shape)), early_stopping)
        assert block.at.size == 0
        lower = np.nextafter(L, np.inf)
        climb_by(fit, p, lower, np.zeros((1, *P.shape)), early_stopping)
        assert np.array_equal(lower, L)


@dataclass(frozen=True)
class Root(Expression):
    """y = a sqrt(b + x), which is not a number for b below the smallest -x."""

    inputs = MappingProxyType({"x": "1"})
    parameters = MappingProxyType({"a": "1", "b": "1"})
    output = "1"

    @property
    def value(self) -> Formula:
        return lambda inputs, theta: theta[0] * np.sqrt(theta[1] + inputs[0])

    @property
    def derivatives(self) -> Formula:
        return lambda inputs, theta: (
            np.sqrt(theta[1] + inputs[0]),
            theta[0] / (2 * np.sqrt(theta[1] + inputs[0])),
        )


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_losses_that_are_no_numbers_are_rejected_alike() -> None:
    x = np.linspace(0, 1, 200)
    fit = taped(Root(), x, np.sqrt(0.02 + x), np.arange(200))
    space = space_of(Root(), [(0, 3), (-1, 1)])
    climbed, general = both(fit, MIHO(R=100, eta=3, early_stopping=False), space=space)
    same(climbed, general)
    assert climbed.rejected == general.rejected
    assert climbed.rejected["loss is nan"] > 100
    stopped, _ = both(fit, MIHO(R=100, eta=3), space=space)
    same(stopped, general)


def test_overflow_and_holes_in_the_data_are_rejected_alike(fit: TapedLoss) -> None:
    for value, word in ((np.nan, "nan"), (np.inf, "inf"), (1e200, "inf")):
        y = fit.y.copy()
        y[7] = value
        holed = replace(fit, y=y)
        climbed, general = both(holed, MIHO(R=100, eta=3))
        assert climbed.outcome is general.outcome is Outcome.NO_FINITE_VALUE
        assert climbed.rejected == general.rejected == {f"loss is {word}": climbed.evaluations}


def test_ctrl_c_between_blocks_leaves_a_state_that_goes_on(fit: TapedLoss) -> None:
    optimizer = MIHO(R=400, eta=3)
    whole = minimize(optimizer, Watched(fit, False), seed=3)
    record = minimize(optimizer, Watched(fit, until=100), seed=3)
    assert record.outcome is Outcome.INTERRUPTED
    assert record.evaluations < whole.evaluations
    assert record.trace.loss == whole.trace.loss[: len(record.trace)]
    checkpoint = pickle.loads(pickle.dumps(record.checkpoint))
    for compiled in (True, False):
        same(minimize(optimizer, Watched(fit, compiled), seed=3, checkpoint=checkpoint), whole)


def test_a_step_makes_no_more_evaluations_than_the_budget_allows(fit: TapedLoss) -> None:
    """Before anything was timed one, then as many as the clock or the budget allows."""
    ticks, optimizer = count(), MIHO(R=9, eta=3)
    clock = Clock(wall=lambda: 1e-6 * next(ticks))
    watched = Watched(fit)
    n = hyperband_table(9, 3, "ceil")[0].n
    for evaluations in (1, n - 1, n, n + 1):
        oracle = Oracle(watched, Budget(evaluations=n + evaluations), clock=clock)
        state = optimizer.start(oracle, stream("own"))
        optimizer.step(state, oracle)
        with pytest.raises(BudgetExhausted):
            while True:
                optimizer.step(state, oracle)
        assert oracle.evaluations == n + evaluations
        assert state.row == evaluations % n  # of the step that was cut


def test_by_default_a_step_is_one_batch(fit: TapedLoss) -> None:
    method = Halves()
    oracle = Oracle(Watched(fit), Budget())
    state = method.start(oracle, stream("own"))
    assert oracle.evaluations == 0
    method.step(state, oracle)
    assert oracle.evaluations == 1
    method.resume(oracle, state)
    assert oracle.evaluations == 3


class Halves(AskTell[list[float]]):
    """Asks for the middle of the box three times."""

    def init(self, space: Space, rng: np.random.Generator) -> list[float]:
        return []

    def ask(self, state: list[float]) -> Array:
        return (SPACE.low + SPACE.high)[None] / 2

    def tell(self, state: list[float], thetas: Array, losses: Array) -> None:
        state.extend(losses.tolist())

    def done(self, state: list[float]) -> bool:
        return len(state) == 3
