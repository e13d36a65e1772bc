"""The difference-based estimate of what no function of the input explains."""

import math

import numpy as np
import pytest

from miho.identification import irreducible_error
from miho.identification.irreducible import irreducible_interval, irreducible_limit


def test_it_finds_the_noise_of_a_smooth_curve() -> None:
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, 20_000)
    y = np.sin(3 * x) + rng.normal(0, 0.3, x.size)
    assert irreducible_error(x, y) == pytest.approx(0.3, rel=0.03)


def test_a_straight_line_has_none() -> None:
    x = np.sort(np.random.default_rng(1).uniform(0, 5, 100))
    assert irreducible_error(x, 3 * x - 1) < 1e-12


@pytest.mark.parametrize("unit", [2.0**-330, 2.0**330])
def test_the_unit_of_the_output_does_not_matter(unit: float) -> None:
    """Fourth powers of 1e-99 and 1e99 are beyond double precision; powers of 2 keep all digits."""
    x = np.sort(np.random.default_rng(1).uniform(0, 5, (2, 100)))
    y = np.random.default_rng(2).normal(0, 2.0, 100)
    usual, scaled = (irreducible_interval(x[0], y * u) for u in (1.0, unit))
    assert scaled == tuple(unit * value for value in usual)
    assert irreducible_limit(x, y * unit) == unit * irreducible_limit(x, y)


def test_repeated_inputs() -> None:
    x = np.repeat(np.arange(500.0), 8)
    y = np.random.default_rng(2).normal(0, 2.0, x.size)
    assert irreducible_error(x, y) == pytest.approx(2.0, rel=0.1)
    assert math.isnan(irreducible_error(np.array([1.0, 2.0]), np.array([1.0, 2.0])))


@pytest.mark.parametrize("spread", ["even", "growing"])
def test_the_interval_holds_the_noise(spread: str) -> None:
    """Nominally 95 of 100; a binomial of 95 % in 300 is at least 90 % but once in ten thousand."""
    rng, inside, resolved = np.random.default_rng(1), 0, 0
    for _ in range(300):
        x = rng.uniform(-1, 1, 200)
        size = np.full(200, 0.3) if spread == "even" else 0.6 * np.abs(x)
        y = np.sin(3 * x) + size * rng.standard_normal(200)
        interval = irreducible_interval(x, y)
        inside += interval.low <= np.sqrt(np.mean(size**2)) <= interval.high
        resolved += interval.resolved
    assert inside >= 270
    assert resolved >= 290


def test_points_too_far_apart_tell_nothing() -> None:
    """Six points of a wave without noise: what they differ by is the wave."""
    x = np.linspace(0, 6, 6)
    interval = irreducible_interval(x, np.sin(x))
    assert interval.low == 0
    assert not interval.resolved
    assert irreducible_interval(x[:4], x[:4] ** 2).high == math.inf


def test_the_limit_of_several_inputs_is_above_the_noise() -> None:
    """Nominally 975 of 1,000; a binomial of that is below 955 once in ten thousand."""
    rng = np.random.default_rng(3)
    limits = [
        irreducible_limit(rng.uniform(-1, 1, (2, 100)), rng.normal(0, 2.0, 100))
        for _ in range(1000)
    ]
    assert 955 <= sum(limit >= 2.0 for limit in limits) < 1000
    for p, rows in ((2, 200), (3, 2000), (5, 500)):
        X = rng.uniform(-1, 1, (p, rows))
        y = np.sin(2 * X[0]) * X[1] + rng.normal(0, 0.1, rows)
        assert irreducible_limit(X, y) >= 0.1, "what the function does adds to it"


def test_the_limit_of_several_inputs_is_near_the_noise() -> None:
    """Of 600 rows it is some 10 % above, in any units and places of the inputs, on a grid and of
    repeated rows too: 3 to 4 standard deviations of 100 pairs and more are 20 % to 40 %."""
    rng = np.random.default_rng(4)
    grid = np.array(np.meshgrid(np.arange(20.0), np.arange(30.0))).reshape(2, -1)
    repeated = np.repeat(rng.uniform(-1, 1, (2, 150)), 4, axis=1)
    for X in (rng.uniform(-1, 1, (2, 600)), grid, 1e9 + 1e-3 * grid, repeated):
        assert irreducible_limit(X, rng.normal(0, 3.0, 600)) == pytest.approx(3.3, rel=0.3)
    assert irreducible_limit(repeated, 1e3 * repeated[0] + rng.normal(0, 3.0, 600)) < 4.2
    constant = np.stack([rng.uniform(-1, 1, 600), np.full(600, 7.0)])
    assert irreducible_limit(constant, 5 * constant[1]) == 0.0
    assert irreducible_limit(grid[:, :5], np.arange(5.0)) == math.inf
