"""Residuals with structure are told from noise, whatever the noise of a row is distributed like."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from miho.optim import Budget
from miho.optim.credibility import structured
from miho.optim.oracle import Oracle
from miho.optim.structure import LEVEL, MOST, has_structure
from tests.optim.decays import fit

Array = NDArray[np.float64]
NOISE: dict[str, Callable[[np.random.Generator, int], Array]] = {
    "normal": lambda rng, n: rng.standard_normal(n),
    "heavy tails": lambda rng, n: rng.standard_cauchy(n),
    "skewed": lambda rng, n: np.exp(rng.standard_normal(n)),
    "two values": lambda rng, n: rng.choice([-1.0, 1.0], n),
}


def image(side: int) -> list[Array]:
    """The two columns of an image's pixels."""
    return [column.ravel() for column in np.meshgrid(*[np.arange(float(side))] * 2)]


@pytest.mark.parametrize("noise", NOISE)
@pytest.mark.parametrize("rows", [30, 300])
def test_noise_has_no_structure(noise: str, rows: int) -> None:
    """Of 200 samples 2 are expected by LEVEL: more than 8 come up once in 4,000 times (Poisson)."""
    rng = np.random.default_rng(0)
    found = sum(
        has_structure(inputs, NOISE[noise](rng, inputs[0].size))
        for _ in range(50)
        for inputs in (
            [np.linspace(0, 1, rows)], [np.geomspace(1, 1000, rows)], list(rng.random((2, rows))),
            image(int(rows**0.5)),
        )
    )  # fmt: skip
    assert found <= 4 * 200 * LEVEL


@pytest.mark.parametrize("rows", [60, 400])
def test_noise_that_is_larger_in_places_has_no_structure(rows: int) -> None:
    """Of 200 samples, as above; in a quarter of 400 rows there was one with a unit for all rows."""
    rng, x = np.random.default_rng(7), np.linspace(0, 1, rows)
    noise = [50**-x * rng.standard_normal(rows) for _ in range(100)]
    noise += [(1 + 49 * x) * rng.standard_normal(rows) for _ in range(100)]
    assert sum(has_structure([x], each) for each in noise) <= 4 * 200 * LEVEL


def test_a_peak_that_was_missed_in_uneven_noise_is_a_structure() -> None:
    """Of 10 standard deviations of the noise at its place, over some 5 of 60 rows."""
    rng, x = np.random.default_rng(8), np.linspace(0, 1, 60)
    for place in (0.5, 0.75, 0.95):
        peak = 10 * 50**place * np.exp(-(((x - place) / 0.05) ** 2))
        found = sum(has_structure([x], peak + 50**x * rng.standard_normal(60)) for _ in range(20))
        assert found >= 18


def test_a_peak_that_was_missed_is_a_structure() -> None:
    """Its rows are few, and far above the others: they must not count as outliers."""
    rng, x = np.random.default_rng(1), np.linspace(0, 100, 300)
    peak = 30 * np.exp(-(((x - 40) / 0.8) ** 2))
    assert has_structure([x], peak + rng.standard_normal(300))
    assert has_structure([x], -peak + rng.standard_normal(300))


def test_a_single_outlier_is_none() -> None:
    rng, x = np.random.default_rng(2), np.linspace(0, 100, 300)
    residuals = rng.standard_normal(300)
    residuals[100] = 1e6
    assert not has_structure([x], residuals)


@pytest.mark.parametrize("period", [2.3, 11.0, 90.0])
def test_a_period_that_was_missed_is_a_structure(period: float) -> None:
    """Of an amplitude of the noise's: neighbours that are a row apart say nothing of period 2.3."""
    rng, x = np.random.default_rng(3), np.linspace(0, 100, 101)
    assert has_structure([x], np.sin(2 * np.pi * x / period) + rng.standard_normal(101))


def test_each_part_is_tested_alone_and_all_together() -> None:
    """A wave in one part, and a shift from one to the other; noise in parts has no structure."""
    rng, x = np.random.default_rng(3), np.tile(np.linspace(0, 1, 100), 2)
    part = np.repeat([0.0, 1.0], 100)
    noise = rng.standard_normal((100, 200))
    wave = np.where(part == 0, np.sin(120 * x), 0.0)
    sizes = np.where(part == 0, 1.0, 4.0)  # of a sigma that is wrong
    alone = [has_structure([part, x], wave + sizes * each, parts=part) for each in noise[:20]]
    mixed = [has_structure([part, x], wave + sizes * each) for each in noise[:20]]
    assert sum(alone) >= 15 > 5 >= sum(mixed)
    shift = np.where(part == 0, 0.8, 0.0)
    assert sum(has_structure([part, x], shift + each, parts=part) for each in noise[:20]) >= 15
    assert sum(has_structure([part, x], each, parts=part) for each in noise) <= 4


def test_a_wave_and_a_spot_are_structures_of_two_inputs() -> None:
    """Along each input alone neither is seen: the wave cancels, the spot is a few of 900 rows."""
    rng = np.random.default_rng(4)
    inputs, columns = list(rng.uniform(0, 10, (2, 400))), image(30)
    wave = np.sin(3 * inputs[0] + 4 * inputs[1])
    spot = 4 * np.exp(-(((columns[0] - 12) / 1.5) ** 2) - ((columns[1] - 20) / 1.5) ** 2)
    assert has_structure(inputs, wave + rng.standard_normal(400))
    assert has_structure(columns, spot + rng.standard_normal(900))


def test_long_data_are_sampled_evenly() -> None:
    rng, n = np.random.default_rng(5), 10 * MOST
    x = np.linspace(0, 1, n)
    assert has_structure([x], 0.2 * np.sin(20 * x) + rng.standard_normal(n))
    assert not has_structure([x], rng.standard_normal(n))


def test_of_long_data_a_share_is_looked_at() -> None:
    """In the problem's own order of rows, in which residuals and inputs must agree."""
    oracle = Oracle(fit(3 * MOST), Budget())
    assert not structured(oracle, np.array([2.0, 0.7, 0.3]))
    assert oracle.evaluations == pytest.approx(1 / 3)
    assert structured(oracle, np.array([2.0, 0.75, 0.3]))


@pytest.mark.parametrize("residuals", [np.zeros(50), np.full(50, 3.0), np.arange(5.0)])
def test_too_little_to_see_is_no_structure(residuals: Array) -> None:
    assert not has_structure([np.linspace(0, 1, residuals.size)], residuals)
    assert not has_structure([np.zeros(residuals.size)], residuals)


def test_inputs_as_wide_as_numbers_reach_are_tested() -> None:
    """The range of this input overflows, and so would the positions of its rows."""
    rng, x = np.random.default_rng(6), np.linspace(-1.0, 1.0, 100)
    noise = rng.standard_normal(100)
    assert not has_structure([1.7e308 * x], noise)
    assert has_structure([1.7e308 * x], noise + 3 * np.sin(20 * x))
