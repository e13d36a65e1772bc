"""Hyperband and successive halving: who is evaluated, on how much, and what it costs."""

import math
from fractions import Fraction

import numpy as np
import pytest

from miho import Budget, Optimizer, Parameter, Problem, Space, minimize
from miho.methods.hyperband import Hyperband, SuccessiveHalving
from miho.optim import Outcome
from miho.quantities import Array

PUBLISHED = [
    [(81, 1), (27, 3), (9, 9), (3, 27), (1, 81)],
    [(34, 3), (11, 9), (3, 27), (1, 81)],
    [(15, 9), (5, 27), (1, 81)],
    [(8, 27), (2, 81)],
    [(5, 81)],
]
"""Li et al. (2018), Table 1: configurations and resource, R = 81 and eta = 3."""


class Batches(Problem):
    """Distance from 0.7, and from more of it the less data is used; remembers every batch."""

    name = "batches"
    space = Space((Parameter("x", "-", 0.0, 1.0),))

    def __init__(self) -> None:
        self.batches: list[tuple[float, list[float]]] = []

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        last = self.batches[-1] if self.batches else (0.0, [])
        if fidelity == last[0]:  # the oracle may cut a batch into chunks
            last[1].extend(thetas[:, 0].tolist())
        else:
            self.batches.append((fidelity, thetas[:, 0].tolist()))
        return np.abs(thetas[:, 0] - 0.7 * fidelity)


def run(method: Optimizer, evaluations: int) -> tuple[Batches, float]:
    problem = Batches()
    record = minimize(method, problem, Budget(evaluations=evaluations), seed=5)
    assert record.outcome is Outcome.BUDGET
    return problem, record.evaluations


def test_hyperband_goes_through_the_published_table() -> None:
    """Two rungs that follow each other at one fidelity, 1 and 5 at R, are one batch here."""
    problem, _ = run(Hyperband(R=81, eta=3), 60)
    batches = [(len(x), round(f * 81)) for f, x in problem.batches[: 5 + 4 + 3 + 2]]
    expected = [rung for bracket in PUBLISHED for rung in bracket][:13]
    assert batches[:13] == expected
    assert batches[13] == (2 + 5, 81)


@pytest.mark.parametrize(
    ("method", "eta"),
    [(Hyperband(R=81, eta=3), 3), (SuccessiveHalving(n=64, R=64, eta=2), 2)],
)
def test_the_best_of_each_rung_go_on(method: Optimizer, eta: int) -> None:
    problem, _ = run(method, 15)
    pairs = 0
    for (f, before), (g, after) in zip(problem.batches, problem.batches[1:], strict=False):
        if g > f and len(after) == len(before) // eta:
            ranked = sorted(before, key=lambda x: abs(x - 0.7 * f))
            assert after == ranked[: len(after)]
            pairs += 1
    assert pairs >= 4


def test_a_bracket_costs_what_its_table_says() -> None:
    """Fractions with a power of two are exact: 7 rungs of one evaluation, and the next begins."""
    problem, evaluations = run(SuccessiveHalving(n=64, R=64, eta=2), 7)
    assert evaluations == 7
    assert [(len(x), Fraction(f)) for f, x in problem.batches] == [
        (2 ** (6 - k), Fraction(2**k, 64)) for k in range(7)
    ]


def test_a_run_of_hyperband_costs_its_table_in_fractions() -> None:
    """Whole brackets only: the sum of n r over the table, to the rounding of 1 / 81."""
    total = sum(n * r for bracket in PUBLISHED for n, r in bracket)
    problem, evaluations = run(Hyperband(R=81, eta=3), math.ceil(total / 81))
    cost = sum(len(x) * Fraction(round(f * 81), 81) for f, x in problem.batches)
    assert evaluations == pytest.approx(float(cost), rel=1e-12)
    assert cost <= math.ceil(total / 81)


def test_only_all_rows_can_become_best() -> None:
    record = minimize(SuccessiveHalving(n=64, R=64, eta=2), Batches(), Budget(evaluations=28))
    assert record.theta is not None
    assert len(record.trace) <= 4
    assert record.loss == pytest.approx(abs(record.theta[0] - 0.7))
    assert record.trace.evaluations[0] == pytest.approx(7)


def test_brackets_draw_afresh() -> None:
    problem, _ = run(SuccessiveHalving(n=8, R=8, eta=2), 40)
    firsts = [tuple(x) for f, x in problem.batches if f == 1 / 8]
    assert len(firsts) == 10
    assert len(set(firsts)) == 10
    assert firsts[0] == tuple(Batches.space.seeded("batches", 5).initial(8)[:, 0])


def test_a_largest_resource_that_is_no_power() -> None:
    problem, _ = run(SuccessiveHalving(n=10, R=10, eta=3), 12)
    assert [(len(x), f) for f, x in problem.batches[:3]] == [(10, 0.1), (3, 0.3), (1, 1.0)]


def test_settings_are_checked() -> None:
    with pytest.raises(ValueError, match="eta is 1; expected a whole number of at least 2"):
        Hyperband(eta=1)
    with pytest.raises(ValueError, match="configurations in the first bracket is 100000000"):
        Hyperband(R=10**8, eta=10)
    with pytest.raises(ValueError, match="n is 0"):
        SuccessiveHalving(n=0)
