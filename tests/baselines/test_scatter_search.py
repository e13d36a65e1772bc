"""Enhanced scatter search: its rectangles, its reference set, its searches, and what it finds."""

import numpy as np
import pytest

from miho import Budget, Oracle, Parameter, Problem, Space, minimize
from miho.methods import scatter_search
from miho.methods.descent import Lowest
from miho.methods.scatter_search import ScatterSearch, _ReferenceSet, rectangles
from miho.optim import BudgetExhausted
from miho.quantities import Array
from miho.testing import DecayFit
from tests.identification.published import mgh09


class Bowl(Problem):
    """Squared distance to a corner of the unit cube: the further the better."""

    name = "bowl"
    space = Space(tuple(Parameter(n, "-", 0.0, 1.0) for n in "abc"))

    def __init__(self) -> None:
        self.thetas: list[Array] = []

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        self.thetas.extend(thetas.copy())
        return np.asarray(np.sum((1 - thetas) ** 2, axis=1))


def reference_set(problem: Problem, b: int = 4) -> _ReferenceSet:
    return _ReferenceSet(Oracle(problem, Budget()), np.random.default_rng(3), b, 10)


def test_it_finds_the_certified_minimum() -> None:
    record = minimize(ScatterSearch(), mgh09(), Budget(evaluations=3000), seed=1)
    assert record.loss * 11 == pytest.approx(3.0750560385e-4, rel=1e-8)


def test_the_reference_set_has_the_published_size() -> None:
    """The smallest even b with b^2 - b >= 10 d."""
    for d in (1, 2, 5, 9, 20):
        b = ScatterSearch().size(d)
        assert b % 2 == 0
        assert b * (b - 1) >= 10 * d > (b - 2) * (b - 3)


def test_half_of_the_first_members_are_the_best() -> None:
    problem = Bowl()
    members = reference_set(problem, 8)
    losses = np.sort(Bowl().loss(np.array(problem.thetas)))
    assert len(losses) == 1 + 5 + 30
    assert np.sort(members.losses)[:4] == pytest.approx(losses[:4])
    assert len(np.unique(members.x, axis=0)) == 8


def test_rectangles_lean_to_the_better_of_two() -> None:
    """By hand for members at 0.4, 0.5, 0.7, 0.2, the best first, with b - 2 = 2."""
    low, high = rectangles(np.array([[0.4], [0.5], [0.7], [0.2]]))
    np.testing.assert_allclose(low[0, :, 0], [0.35, 0.4 - 0.15 * 1.5, 0.4 + 0.1 * 2])
    np.testing.assert_allclose(high[0, :, 0], [0.45, 0.4 + 0.15 * 0.5, 0.4 - 0.1 * 0])
    np.testing.assert_allclose(low[3, 0], [0.2 - 0.1 * (1 - 1)])
    np.testing.assert_allclose(high[3, 0], [0.2 + 0.1 * (1 + 1)])
    low, high = rectangles(np.array([[0.1], [0.9], [0.8]]))
    np.testing.assert_allclose(low[0, :, 0], [0.0, 0.0])
    np.testing.assert_allclose(high[1, 1, 0], 0.85)


def test_what_helps_is_gone_beyond() -> None:
    """From 0.2 over 0.3 on and on, as the corner is at 1: each step of it is an improvement."""
    problem = Bowl()
    members = reference_set(problem)
    members.x[0], members.losses[0] = np.full(3, 0.2), 3 * 0.8**2
    before = len(problem.thetas)
    x, loss = members._beyond(0, np.full(3, 0.3), 3 * 0.7**2)
    beyond = np.array(problem.thetas[before:])
    assert len(beyond) > 3
    assert loss == pytest.approx(float(np.sum((1 - x) ** 2)))
    assert loss == Bowl().loss(beyond).min()
    steps = np.diff(np.vstack([np.full(3, 0.2), np.full(3, 0.3), beyond]), axis=0)
    assert (steps >= 0).all()
    reach = np.array([1, 2, 2, 4, 4, 8])[: len(steps) - 1, None]
    assert (steps[1:][: len(reach)] <= reach * steps[:-1][: len(reach)] + 1e-12).all()


def test_twins_and_members_that_are_stuck_are_replaced() -> None:
    problem = Bowl()
    members = reference_set(problem)
    members.x[2] = members.x[1] + 5e-4
    members.losses[2] = members.losses[1] + 1e-9
    pair = members.x[1:3].copy()
    members.replace_twins(1e-3)
    assert [row.tolist() in members.x.tolist() for row in pair] == [True, False]
    nothing = np.full((4, 3), np.inf)
    before = members.x.copy()
    for _ in range(19):
        members.update(np.zeros((4, 3, 3)), nothing, 20)
    assert (members.x == before).all()
    members.update(np.zeros((4, 3, 3)), nothing, 20)
    assert (members.x != before).all()


def test_local_searches_start_when_they_are_due(monkeypatch: pytest.MonkeyPatch) -> None:
    """After the first iteration from the best, then every third from a child."""
    iterations: list[int] = []
    starts: list[Array] = []
    combined = 0
    combine = _ReferenceSet.combine

    def counted(self: _ReferenceSet) -> tuple[Array, Array]:
        nonlocal combined
        combined += 1
        return combine(self)

    def search(oracle: Oracle, start: Array, *settings: object) -> Lowest:
        iterations.append(combined)
        starts.append(start)
        best.append(np.array(oracle.trace.theta[-1]))
        return Lowest(oracle.residuals, start)

    best: list[Array] = []
    monkeypatch.setattr(_ReferenceSet, "combine", counted)
    monkeypatch.setattr(scatter_search, "local_search", search)
    oracle = Oracle(DecayFit(), Budget(evaluations=2000))
    with pytest.raises(BudgetExhausted):
        ScatterSearch(first=1, between=3).run(oracle, np.random.default_rng(1))
    assert iterations[:4] == [1, 4, 7, 10]
    assert starts[0] == pytest.approx(best[0])


def test_a_start_is_chosen_by_quality_and_diversity() -> None:
    """Two parents with two children each; what is known is at 0."""
    children = np.array([[[0.1], [0.9]], [[0.2], [0.8]]])
    losses = np.array([[1.0, 4.0], [2.0, 3.0]])
    searched = [np.zeros(1)]
    assert ScatterSearch(balance=0.0).choice(children, losses, searched) == (0, 0)
    assert ScatterSearch(balance=1.0).choice(children, losses, searched) == (0, 1)
    better = np.array([[1.0, 4.0], [2.0, 1.5]])
    assert ScatterSearch(balance=0.5).choice(children, better, searched) == (1, 1)


def test_unusable_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="members is 2"):
        ScatterSearch(members=2)
    with pytest.raises(ValueError, match="balance is 2"):
        ScatterSearch(balance=2)
