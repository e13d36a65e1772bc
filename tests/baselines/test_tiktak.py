"""TikTak: what weighs how much, where it descends from, and what it finds."""

import numpy as np
import pytest

from miho import Budget, Oracle, minimize
from miho.methods import tiktak
from miho.methods.descent import Lowest
from miho.methods.tiktak import TikTak
from miho.optim import Outcome
from miho.quantities import Array
from miho.testing import DecayFit
from tests.identification.published import mgh09


def test_it_finds_the_certified_minimum() -> None:
    """To ten digits, as a descent ends where a step gains less than 1e-10."""
    record = minimize(TikTak(), mgh09(), Budget(evaluations=40_000), seed=1)
    assert record.outcome is Outcome.CONVERGED
    assert record.loss * 11 == pytest.approx(3.0750560385e-4, rel=1e-9)


def test_weights_grow_as_published() -> None:
    """min(max(0.1, sqrt(i / N)), 0.995) for the i-th of N searches, and nothing for the first."""
    weights = [TikTak().weight(i, 1000) for i in (1, 2, 10, 250, 640, 1000)]
    assert weights == pytest.approx([0.0, 0.1, 0.1, 0.5, 0.8, 0.995])


def test_searches_start_between_the_next_point_and_the_lowest_so_far(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The second search is the best; b is on a log scale, where its means are geometric."""
    starts: list[Array] = []
    ends = [np.array([1.0, 1.0]), np.array([4.0, 0.1]), np.array([-4.0, 9.0])]
    losses = [2.0, 1.0, 3.0]

    def search(oracle: Oracle, start: Array, *settings: object) -> Lowest:
        lowest = Lowest(oracle.residuals, ends[len(starts) % 3])
        lowest.loss = losses[len(starts) % 3]
        starts.append(start)
        return lowest

    monkeypatch.setattr(tiktak, "local_search", search)
    problem = DecayFit()
    TikTak(points=15, share=0.1).run(Oracle(problem, Budget()), np.random.default_rng(5))
    order = np.argsort(problem.losses)
    best_points = np.array(problem.thetas)[order[:3]]
    assert len(starts) == 3
    assert starts[0] == pytest.approx(best_points[0])
    for i, best in ((1, ends[0]), (2, ends[1])):
        w = np.sqrt((i + 1) / 3) if i < 2 else 0.995
        assert starts[i][0] == pytest.approx((1 - w) * best_points[i][0] + w * best[0])
        assert starts[i][1] == pytest.approx(best_points[i][1] ** (1 - w) * best[1] ** w)


def test_rounds_are_counted_and_draw_new_points() -> None:
    problem = DecayFit()
    record = minimize(TikTak(points=20, rounds=2), problem, seed=1)
    assert record.descents is not None
    assert record.descents.started == 8
    assert len(np.unique(np.array(problem.thetas), axis=0)) > 80


def test_unusable_settings_are_refused() -> None:
    with pytest.raises(ValueError, match=r"share is 1\.5; expected at most 1"):
        TikTak(share=1.5)
    with pytest.raises(ValueError, match=r"highest_weight is 0\.05"):
        TikTak(highest_weight=0.05)
