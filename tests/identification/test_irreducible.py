"""The difference-based estimate of what no function of the input explains."""

import math

import numpy as np
import pytest

from miho.identification import irreducible_error


def test_it_finds_the_noise_of_a_smooth_curve() -> None:
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, 20_000)
    y = np.sin(3 * x) + rng.normal(0, 0.3, x.size)
    assert irreducible_error(x, y) == pytest.approx(0.3, rel=0.03)


def test_a_straight_line_has_none() -> None:
    x = np.sort(np.random.default_rng(1).uniform(0, 5, 100))
    assert irreducible_error(x, 3 * x - 1) < 1e-12


def test_repeated_inputs() -> None:
    x = np.repeat(np.arange(500.0), 8)
    y = np.random.default_rng(2).normal(0, 2.0, x.size)
    assert irreducible_error(x, y) == pytest.approx(2.0, rel=0.1)
    assert math.isnan(irreducible_error(np.array([1.0, 2.0]), np.array([1.0, 2.0])))
