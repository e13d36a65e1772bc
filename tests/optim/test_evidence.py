"""When a search has evidence enough to stop, and what a run keeps of its descents."""

import copy
import json
import math
import pickle
from dataclasses import asdict, dataclass, field, replace
from math import comb

import numpy as np
import pytest
from numpy.typing import NDArray

from miho import MIHOGN, AskTell, Budget, Optimizer, Oracle, Parameter, Space, minimize
from miho.methods.least_squares import LeastSquares
from miho.methods.local_search import LBFGSB
from miho.optim import (
    MIHOQN,
    Agreement,
    Descents,
    LeastSquaresProblem,
    Outcome,
    Starts,
    agreement,
)
from miho.testing import DecayFit

Array = NDArray[np.float64]


def expected_unseen(optima: int, starts: int) -> float:
    """The share of cells not seen, from Bayes' theorem, for any number of optima being as likely.

    For k optima all shares are as likely (Dirichlet), so that all ways to spread n starts over k
    are; the k - w not seen then have a share of (k - w) / (n + k).
    """
    weights, shares = 0.0, 0.0
    for k in range(optima, 20_000):
        weight = comb(k, optima) / comb(starts + k - 1, starts)
        weights += weight
        shares += weight * (k - optima) / (starts + k)
    return shares / weights


@pytest.mark.parametrize(("optima", "starts"), [(1, 5), (2, 9), (3, 12), (4, 30), (7, 12)])
def test_the_share_not_seen_is_the_one_that_bayes_theorem_gives(optima: int, starts: int) -> None:
    """To 1e-3: what the sum leaves out above 20,000 optima falls with their square at least."""
    ends = [float(1 + k % optima) for k in range(starts)]
    assert agreement(ends).unseen == pytest.approx(expected_unseen(optima, starts), rel=1e-3)


ROUNDED = [0.0, 1e-30, 3e-28, 2e-27, 5e-25, 1e-24, 7e-22]
"""Ends on data without error."""


@pytest.mark.parametrize(
    ("ends", "rounding", "expected", "enough"),
    [
        ([], 0.0, Agreement(0, 0, 0, 1.0), False),
        ([2.0], 0.0, Agreement(1, 1, 1, 1.0), False),
        ([1.0] * 4, 0.0, Agreement(4, 4, 1, 2 / 12), False),
        ([1.0] * 6, 0.0, Agreement(6, 6, 1, 2 / 30), False),
        ([1.0, 1.00009] + [1.0] * 5, 0.0, Agreement(7, 7, 1, 2 / 42), True),
        ([1.0, 1.00011] + [1.0] * 5, 0.0, Agreement(6, 7, 2, 6 / 42), False),
        ([1.0] * 5 + [2.0] * 4, 0.0, Agreement(5, 9, 2, 6 / 72), False),
        ([1.0] * 5 + [2.0] * 5, 0.0, Agreement(5, 10, 2, 6 / 90), True),
        ([1.0] * 4 + [2.0] * 6, 0.0, Agreement(4, 10, 2, 6 / 90), False),
        ([1.0] * 5 + [2.0] * 16, 0.0, Agreement(5, 21, 2, 6 / 420), False),
        ([1.0] * 19 + [2.0] * 81, 0.0, Agreement(19, 100, 2, 6 / 9900), False),
        ([1.0] * 20 + [2.0] * 80, 0.0, Agreement(20, 100, 2, 6 / 9900), True),
        (list(range(1, 9)), 0.0, Agreement(1, 8, 8, 1.0), False),
        (ROUNDED, 0.0, Agreement(1, 7, 7, 1.0), False),
        (ROUNDED, 1e-20, Agreement(7, 7, 1, 2 / 42), True),
    ],
)  # fmt: skip
def test_ends_that_agree_are_evidence(
    ends: list[float], rounding: float, expected: Agreement, enough: bool
) -> None:
    agreed = agreement(ends, rounding)
    assert agreed == expected
    assert agreed.enough is enough
    assert agreement(ends[::-1], rounding) == agreed, "whatever their order"


def test_an_optimum_from_elsewhere_is_compared_with_the_ends() -> None:
    assert agreement([1.0, 1.0, 2.0], best=0.5).agreeing == 0
    assert agreement([1.0] * 10, finished=50).enough is False, "the best 10 of 50"


def test_what_was_dropped_ended_in_an_optimum_of_its_own() -> None:
    agreed = agreement([1.0] * 9 + [2.0], dropped=2)
    assert agreed == Agreement(9, 12, 4, 20 / 132)
    assert agreement([1.0] * 9 + [2.0, 3.0, 4.0]) == agreed
    assert agreement([1.0] * 9 + [2.0], finished=12, dropped=2) == agreed


def test_ends_agree_on_the_best_of_the_run() -> None:
    """Where something better was looked at in passing, nothing has come back to it."""
    oracle = Oracle(Constant(), Budget())
    oracle(oracle.space.decode(oracle.space.initial(1)))
    for _ in range(9):
        oracle.starts.add(math.inf, 1.001)
    agreement = oracle.starts.agreement(oracle.best)
    assert (agreement.agreeing, agreement.finished) == (0, 9)
    for _ in range(9):
        oracle.starts.add(math.inf, 1.00001)
    agreement = oracle.starts.agreement(oracle.best)
    assert (agreement.agreeing, agreement.finished) == (9, 18)
    descents = Descents.of(oracle.meter.starts, oracle.best)
    assert descents is not None
    assert descents.agreeing == 9


@dataclass(frozen=True)
class Returning(Optimizer):
    """Brackets of ten, of which the last is cut by the budget; all end in the first one's best."""

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        best = math.inf
        while not oracle.starts.agreement(oracle.best).enough:
            oracle.starts.screened += 10
            oracle.starts.add(5.0, 4.0, finished=False)
            losses = oracle(oracle.space.decode(oracle.space.sample(10, rng)))
            best = min(best, float(losses.min()))
            oracle.starts.add(math.inf, best if best < 1 else 1.0, converged=True)


def test_a_method_stops_by_its_evidence_and_the_run_keeps_it() -> None:
    record = minimize(Returning(), Constant(), Budget(evaluations=1000))
    assert record.outcome is Outcome.CONVERGED
    assert record.evaluations == 70
    assert record.descents == Descents(14, 7, 7, 0, (1.0,) * 7, screened=70, agreeing=7)
    cut = minimize(Returning(), Constant(), Budget(evaluations=25)).descents
    assert cut == Descents(5, 2, 2, 0, (1.0,) * 2, screened=30, agreeing=2)


class Constant(DecayFit):
    """Nothing but losses of 1."""

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        return np.ones(len(thetas))


class Subsets(DecayFit):
    """On a half of the rows the loss is 0."""

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        return np.full(len(thetas), float(fidelity == 1.0))


def test_a_loss_on_fewer_rows_is_no_end() -> None:
    oracle = Oracle(Subsets(), Budget())
    theta = oracle.space.decode(oracle.space.initial(1))
    with oracle.starts.descent():
        oracle(theta, 0.5)
        oracle(theta)
    assert oracle.meter.starts.ends == [1.0]


class Exact(DecayFit):
    """Data without error."""

    rounding = 1e-20

    def __init__(self) -> None:
        super().__init__()
        self.y = 2.0 * np.exp(-1.5 * self.t)


def test_data_without_error_agree_to_rounding() -> None:
    exact = minimize(LBFGSB(screen=20, starts=5, rounds=1), Exact()).descents
    assert exact is not None
    assert exact.ends[-1] > 1.1 * exact.ends[0], "or this tests nothing"
    assert exact.agreeing == exact.finished == 5
    assert exact.screened == 20


@dataclass
class Brackets:
    """A state that holds the run's starts."""

    rng: np.random.Generator
    starts: Starts = field(default_factory=Starts)


@dataclass(frozen=True)
class InTurns(AskTell[Brackets]):
    """Batches of ten, each of which is a descent."""

    def init(self, space: Space, rng: np.random.Generator) -> Brackets:
        return Brackets(rng)

    def ask(self, state: Brackets) -> Array:
        return DecayFit.space.decode(DecayFit.space.sample(10, copy.deepcopy(state.rng)))

    def tell(self, state: Brackets, thetas: Array, losses: Array) -> None:
        DecayFit.space.sample(10, state.rng)
        state.starts.screened += len(losses)
        state.starts.add(float(losses[0]), float(losses.min()), converged=False)

    def start(self, oracle: Oracle, rng: np.random.Generator) -> Brackets:
        return Brackets(rng, oracle.meter.starts)

    def done(self, state: Brackets) -> bool:
        return len(state.starts.descents) == 6


def test_a_resumed_run_keeps_the_descents_before() -> None:
    method, problem = InTurns(), DecayFit()
    problem.rounding = 1e9
    whole = minimize(method, problem).descents
    assert whole is not None
    assert whole.agreeing == 6, "the state knows what is rounding to the problem"
    assert (whole.started, whole.finished, whole.converged, whole.screened) == (6, 6, 0, 60)
    cut = minimize(method, problem, Budget(evaluations=35))
    assert cut.descents is not None
    assert cut.descents.finished == 3
    checkpoint = pickle.loads(pickle.dumps(cut.checkpoint))
    assert minimize(method, problem, checkpoint=checkpoint).descents == whole


def test_a_run_keeps_the_places_where_its_best_descents_ended() -> None:
    starts = Starts()
    for loss, place in (
        (3.0, [5.0, 0.0]),
        (1.0, [2.0, 1e-4]),
        (1.00001, [2.001, 0.0]),
        (2.0, [4, 1]),
    ):
        starts.add(math.inf, loss, theta=np.array(place))
    starts.add(math.inf, 0.5)
    starts.add(math.inf, 0.1, theta=np.zeros(2), finished=False)
    descents = Descents.of(starts, 0.5)
    assert descents is not None
    assert descents.minima == ((1.0, (2.0, 1e-4)), (2.0, (4.0, 1.0)), (3.0, (5.0, 0.0)))
    stored = json.loads(json.dumps(asdict(descents)))
    assert Descents.from_stored(stored) == descents
    del stored["minima"]  # as of older versions
    assert Descents.from_stored(stored) == replace(descents, minima=())


@dataclass(frozen=True)
class Wave(LeastSquaresProblem):
    """A wave of frequency b through 40 points of two, whose loss has several minima in the box."""

    space = Space((Parameter("a", "-", 0.1, 3.0), Parameter("b", "-", 0.5, 12.0)))
    name = "wave"
    unit = "-"

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        t = np.linspace(0, 3, 40)
        return np.asarray(theta[0] * np.sin(theta[1] * t) - np.sin(5 * t) - 0.1 * np.cos(9 * t))

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        t = np.linspace(0, 3, 40)
        return np.stack([np.sin(theta[1] * t), theta[0] * t * np.cos(theta[1] * t)], axis=1)

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        return np.array([np.mean(self.residuals(theta) ** 2) for theta in thetas])


@pytest.mark.parametrize(
    "method", [MIHOGN(), MIHOQN(), LBFGSB(screen=20, starts=8), LeastSquares(screen=20, starts=8)]
)
def test_methods_that_descend_say_where_they_ended(method: Optimizer) -> None:
    """Every minimum has the loss of its place; to 1e-9, as sums of 40 squares are rounded."""
    problem = Wave()
    descents = minimize(method, problem, Budget(evaluations=4000)).descents
    assert descents is not None
    assert len(descents.minima) > 1, "this wave has several minima"
    losses = problem.loss(np.array([minimum.theta for minimum in descents.minima]))
    assert [minimum.loss for minimum in descents.minima] == pytest.approx(
        losses, rel=1e-9, abs=1e-15
    )
    # The second wave moves the optimum by 0.006.
    assert descents.minima[0].theta == pytest.approx([1, 5], abs=1e-2)
    assert descents.minima[0].loss == pytest.approx(descents.ends[0], abs=1e-15)
