"""Virtual workers take the time that workers would, and decide nothing."""

import math
from threading import Event

import numpy as np
import pytest

from experiments.benchmarks.sleeping import (
    Decay,
    Lengths,
    Sleeping,
    VirtualPool,
    simulations,
    virtual_search,
)
from miho.optim import MIHO, MIHOGN, Budget, RandomSearch, minimize

EQUAL, SPREAD = Lengths(1.0), Lengths(1.0, 0.7)


def random_search(lengths: Lengths, workers: int, overhead: float = 0.0) -> float:
    """Virtual seconds of 64 evaluations in one batch, but for the first, made alone."""
    budget = Budget(evaluations=64)
    return virtual_search(RandomSearch(batch=64), lengths, workers, overhead, budget).seconds - 1.0


def test_measured_lengths_come_as_often_as_they_were_measured() -> None:
    lengths = Lengths(2.0, measured=(1.0, 2.0, 9.0))
    thetas = np.random.default_rng(0).random((3000, 4))
    seconds, counts = np.unique([lengths(theta) for theta in thetas], return_counts=True)
    assert seconds == pytest.approx([0.5, 1.0, 4.5])
    assert counts == pytest.approx([1000] * 3, abs=130)  # five standard deviations


def test_simulations_of_some_parameters_need_more_steps() -> None:
    solutions = [simulation() for simulation in simulations(8)]
    assert all(solution.success for solution in solutions)
    calls = sorted(solution.nfev for solution in solutions)
    assert 2 * calls[0] < calls[-1]


@pytest.mark.parametrize("workers", [1, 4, 64, 1000])
def test_equal_evaluations_share_the_workers(workers: int) -> None:
    assert random_search(EQUAL, workers) == pytest.approx(max(1, 64 / workers))


def test_a_batch_takes_as_long_as_its_longest_evaluation() -> None:
    problem = Sleeping(SPREAD)
    thetas = problem.space.decode(problem.space.seeded("decay", 0).initial(64))
    longest = max(SPREAD(theta) for theta in thetas)
    assert random_search(SPREAD, 64) == pytest.approx(longest)
    assert random_search(SPREAD, 1) == pytest.approx(sum(SPREAD(theta) for theta in thetas))


def test_the_client_hands_over_one_task_at_a_time() -> None:
    assert random_search(EQUAL, 64, overhead=0.5) == pytest.approx(64 * 0.5 + 1.0)


def test_tasks_end_in_the_order_of_their_ends() -> None:
    pool, news = VirtualPool(2, 0.0), Event()
    call = pool.share(pool.sleep)
    futures = [call(3.0), call(1.0), call(1.0)]
    for future in futures:
        future.add_done_callback(lambda _: news.set())
    ends = []
    for _ in futures:
        pool.wait(news)
        ends.append((pool.now, [future.done() for future in futures]))
    assert ends == [
        (1.0, [False, True, False]),
        (2.0, [False, True, True]),
        (3.0, [True, True, True]),
    ]


@pytest.mark.parametrize("method", [MIHO(R=9, eta=3), MIHOGN(max_brackets=2)])
@pytest.mark.parametrize("workers", [1, 7])
def test_decisions_are_those_of_the_method_alone(method: MIHO | MIHOGN, workers: int) -> None:
    alone = minimize(method, Decay(), seed=3)
    found = virtual_search(method, SPREAD, workers, 1e-3, Budget(), seed=3)
    assert (found.loss, found.evaluations) == (alone.loss, alone.evaluations)


def test_lengths_are_log_normal_and_reproducible() -> None:
    thetas = np.random.default_rng(0).uniform(size=(4000, 3))
    logs = np.log([SPREAD(theta) for theta in thetas])
    assert logs.tolist() == np.log([SPREAD(theta.copy()) for theta in thetas]).tolist()
    # four standard errors of the mean and of the deviation
    assert abs(logs.mean() + 0.7**2 / 2) < 4 * 0.7 / math.sqrt(4000)
    assert abs(logs.std() - 0.7) < 4 * 0.7 / math.sqrt(8000)
