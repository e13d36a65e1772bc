"""The order of rows that a fidelity uses: a permutation whose first rows see every corner."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import scipy.optimize
from numpy.typing import NDArray

from miho.data import Dataset
from miho.identification import CurveFit
from miho.identification.row_order import COVERING, POOL, row_order
from miho.optim import Parameter, Space

Array = NDArray[np.float64]

SEEDS = range(30)


def rng(*seed: int) -> np.random.Generator:
    return np.random.default_rng([*seed, 16])


def rare_values(n: int, seed: int) -> Array:
    """Uniform in [0, 0.8], and one in a hundred in [0.85, 1]: at least one of them."""
    x = rng(seed).uniform(0.0, 0.8, n)
    rare = rng(seed, 1).random(n) < 0.01
    rare[n // 2] = True
    x[rare] = rng(seed, 2).uniform(0.85, 1.0, np.count_nonzero(rare))
    return x


INPUTS: dict[str, Callable[[int], list[Array]]] = {
    "uniform": lambda n: [rng().random(n)],
    "two": lambda n: [rng().random(n), rng(1).normal(size=n)],
    "one constant": lambda n: [np.full(n, 3.0), rng().random(n)],
    "all constant": lambda n: [np.full(n, 3.0)],
    "duplicates": lambda n: [rng().choice([0.0, 1.0, 5.0], n)],
    "sorted": lambda n: [np.linspace(0.0, 10.0, n)],
    "clustered": lambda n: [rng().choice([0.0, 1e-3, 1.0], n) + 1e-6 * rng(1).random(n)],
    "each half of what is left": lambda n: [np.exp2(-np.arange(n, dtype=float))],
    "neighbouring numbers": lambda n: [np.where(np.arange(n) % 2, 1.0, np.nextafter(1.0, 2.0))],
    "as far apart as numbers are": lambda n: [rng().choice([-1.7e308, 0.0, 1.7e308], n)],
    "next to nothing": lambda n: [rng().choice([0.0, 5e-324, 1e-323], n)],
}


@pytest.mark.parametrize("n", [1, 2, 6, 9, 300, 3000])
@pytest.mark.parametrize("kind", INPUTS)
def test_every_row_has_its_place_in_any_data(kind: str, n: int) -> None:
    order = row_order(INPUTS[kind](n), rng())
    assert sorted(order.tolist()) == list(range(n))
    assert np.array_equal(order, row_order(INPUTS[kind](n), rng())), "it is fixed"


def test_more_rows_than_the_pool_and_more_places_than_covering_rows() -> None:
    n = POOL + 5
    order = row_order([np.linspace(0.0, 1.0, n)], rng())
    assert np.array_equal(np.sort(order), np.arange(n))
    assert math.isqrt(n) > COVERING


@pytest.mark.parametrize("n", [10, 3000])
def test_all_but_the_covering_rows_are_random(n: int) -> None:
    """Beside the places 0, 1, 4, 9, ... the order is the permutation without those there."""
    order = row_order([rng().random(n), rng(1).normal(size=n)], rng(5))
    squares = np.arange(math.isqrt(n - 1) + 1) ** 2
    rest = np.delete(order, squares)
    plain = rng(5).permutation(n)
    assert np.array_equal(rest, plain[np.isin(plain, rest)])


def test_a_few_rows_cover_the_range_in_value() -> None:
    """97 % of the rows are in a tenth of the range: 8 covering rows see all of its quarters."""
    for seed in SEEDS:
        x = np.where(rng(seed).random(3000) < 0.97, 0.1, 1.0) * rng(seed, 1).random(3000)
        first = x[row_order([x], rng(seed, 2))[:64]]
        assert np.unique((4 * first / x.max()).astype(int).clip(0, 3)).size == 4, seed


@pytest.mark.parametrize("d", [3, 5, 8])
def test_rare_rows_are_among_the_first_four_per_parameter(d: int) -> None:
    """Of d - 2 inputs the last has one value in a hundred rows far out."""
    for seed in SEEDS:
        x = rare_values(3000, seed)
        inputs = [*rng(seed, 3).uniform(-1.0, 1.0, (d - 3, x.size)), x]
        assert (x[row_order(inputs, rng(seed, 4))[: 4 * d]] > 0.8).any(), seed


def test_a_switch_that_is_rarely_on_is_seen_among_many_inputs() -> None:
    for seed in SEEDS:
        on = np.zeros(3000)
        on[rng(seed).choice(3000, 30, replace=False)] = 1.0
        inputs = [*rng(seed, 1).normal(size=(8, 3000)), on]
        assert on[row_order(inputs, rng(seed, 2))[:20]].any(), seed


def test_one_absurd_row_leaves_the_others_covered() -> None:
    """Once its half of the box is empty, the covering rows are those of the other half."""
    for seed in SEEDS:
        x = rare_values(3000, seed)
        x[7] = 1e9
        first = x[row_order([x], rng(seed, 1))[:25]]
        assert first.max() == 1e9
        assert ((first > 0.8) & (first <= 1.0)).any(), seed


def test_the_mean_over_the_first_rows_is_nearly_that_of_all() -> None:
    """At most as far off as the covering rows weigh, plus chance: five standard errors of 80."""
    x = rare_values(3000, 0)
    rare = (x > 0.8).astype(float)
    orders = [row_order([x], rng(seed)) for seed in range(80)]
    for m in (25, 100, 400):
        share = np.mean([rare[order[:m]].mean() for order in orders])
        error = 5 * math.sqrt(rare.mean() / m / len(orders))
        assert rare.mean() - error <= share <= rare.mean() + 1 / math.sqrt(m) + error


def decay(x: "-", *, a: "-", b: "-", q: "-") -> "-":  # type: ignore[valid-type] # noqa: F722
    """A decay; `q` counts only above 0.8."""
    return a * np.exp(-b * x) + q * np.maximum(x - 0.8, 0.0)


NOISE = 0.005


def problem(seed: int) -> CurveFit:
    x = rare_values(3000, seed)
    y = decay(x, a=1.0, b=2.0, q=3.0) + NOISE * rng(seed, 5).standard_normal(x.size)
    data = Dataset(f"rare_{seed}", {"x": x, "y": y}, {"x": "-", "y": "-"}, "y")
    space = Space(tuple(Parameter(name, "-", 0.0, 10.0) for name in "abq"))
    return CurveFit(decay, data, space)  # type: ignore[arg-type]


def test_a_fit_to_twelve_rows_finds_what_only_rare_rows_determine() -> None:
    """A rare row is 0.05 or more above 0.8: one tells q to 0.005 / 0.05 = 0.1, here six of it."""
    for seed in range(10):
        fit = problem(seed)
        part = fit._order[:12]
        x, y = fit.dataset["x"][part], fit.dataset["y"][part]

        def errors(theta: Array, x: Array = x, y: Array = y) -> Array:
            return np.asarray(fit.model.predict(theta[None], x)[0] - y)  # noqa: B023

        end = scipy.optimize.least_squares(errors, [0.5, 1.0, 0.1], bounds=(0.0, 10.0))
        assert end.x[2] == pytest.approx(3.0, abs=0.6), seed


def test_the_first_rows_determine_all_parameters_unlike_those_of_random_orders() -> None:
    """In all of 20 orders; a random order has a rare row among 12 in 1 - 0.99^12 = 11 % of cases.

    The number of random orders is within five standard deviations of that.
    """
    fit = problem(0)
    x = fit.dataset["x"]
    J = fit.model.jacobian(np.array([1.0, 2.0, 3.0]), x)

    def are_enough(order: NDArray[np.intp]) -> bool:
        return bool(np.linalg.matrix_rank(J[order[:12]]) == 3)

    assert all(are_enough(row_order([x], rng(seed))) for seed in range(20))
    random = sum(are_enough(rng(seed).permutation(x.size)) for seed in range(200))
    assert random == pytest.approx(200 * 0.11, abs=5 * math.sqrt(200 * 0.11 * 0.89))


def test_the_order_is_that_of_the_data() -> None:
    assert np.array_equal(problem(1)._order, problem(1)._order)
    assert not np.array_equal(problem(1)._order, problem(2)._order)
