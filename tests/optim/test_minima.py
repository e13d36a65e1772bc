"""The different places where descents ended."""

from __future__ import annotations

import numpy as np

from miho.optim.trace import MOST_MINIMA, Descent, best_minima


def ended(end: float, *theta: float) -> Descent:
    return Descent(10.0, end, finished=True, converged=True, theta=np.array(theta))


def test_descents_that_ended_in_one_place_count_once() -> None:
    near = [ended(1 + 1e-9, 0.0, 2.001), ended(1.0, 1e-12, 2.0), ended(1 + 1e-8, -1e-12, 2.0)]
    other = ended(0.9, 0.5, 2.0)
    minima = best_minima([*near, other])
    assert [(each.loss, each.theta) for each in minima] == [(0.9, (0.5, 2.0)), (1.0, (1e-12, 2.0))]
    assert best_minima([]) == ()


def test_an_end_far_out_does_not_hide_that_others_differ() -> None:
    minima = best_minima([ended(0.9, 3.6), ended(0.901, 5.4), ended(3.0, 1e6)])
    assert [each.theta[0] for each in minima] == [3.6, 5.4, 1e6]


def test_the_best_places_are_kept() -> None:
    minima = best_minima(ended(float(k), 1.0 + k) for k in reversed(range(2 * MOST_MINIMA)))
    assert [each.loss for each in minima] == list(range(MOST_MINIMA))
