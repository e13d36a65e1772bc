"""Tracking in C: the same decisions as in NumPy, the same bits on all levels, and the door."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from miho import CurveFit, Dataset, Parameter, Space, Tracker
from miho.core import machine
from miho.online.population import Population
from miho.online.state import Mixture, mixture_reach, reach_by_numpy

pytestmark = pytest.mark.skipif(machine() is None, reason="built without a C compiler")

ROWS, FALL = 240, 120
SIZES = (16, 2, 2, 2, 1, 0)


def first(x: Any, z: Any, *, a: Any, b: Any) -> Any:
    return a * np.tanh(b * x) + 0 * z


def second(x: Any, z: Any, *, a: Any, b: Any) -> Any:
    return a * x * z - np.exp(-b * z)


def tracker(u: str = "u", **settings: Any) -> Tracker:
    """A tracker of two outputs; the first one is a state if it is `x_next`."""
    x, z = np.linspace(-2, 2, 30), np.linspace(0.5, 1.5, 30)
    space = Space((Parameter("a", "", 0.1, 5), Parameter("b", "", 0.1, 5)))
    functions: tuple[Any, Any] = first, second
    problems = [
        CurveFit(
            function,
            Dataset(output, {"x": x, "z": z, output: x}, {"x": "", "z": "", output: ""}, output),
            space,
            sigma=0.02,
        )
        for output, function in zip((u, "v"), functions, strict=True)
    ]
    prior = {"a": (2.0, 0.1), "b": (1.0, 0.05)}
    return Tracker(problems, prior, {"a": 0.35}, {"x": 0.01}, **settings)


def by_numpy(u: str = "u") -> Tracker:
    made = tracker(u)
    old = made._population
    made._population = Population(old.layout, old.rules, old.formula, by_machine=False)
    made._population.memory[:] = old.memory
    return made


def stream(seed: int = 0) -> list[dict[str, float]]:
    """Rows with a fall of a, outliers, missing, frozen and infinite values, and odd times."""
    rng = np.random.default_rng(seed)
    x, z = 2 * np.sin(np.arange(ROWS) / 7), 1 + 0.5 * np.cos(np.arange(ROWS) / 11)
    a = np.where(np.arange(ROWS) < FALL, 2.1, 1.4)
    columns: dict[str, Any] = {"x": x + 0.01 * rng.standard_normal(ROWS), "z": z}
    columns["u"] = first(x, z, a=a, b=1.05) + 0.02 * rng.standard_normal(ROWS)
    columns["v"] = second(x, z, a=a, b=1.05) + 0.02 * rng.standard_normal(ROWS)
    columns["time"] = 0.02 * np.arange(ROWS)
    columns["u"][rng.random(ROWS) < 0.03] += 1.0
    columns["u"][40:44] = np.nan
    columns["v"][60:70] = columns["v"][60]
    columns["x"][80] = np.inf
    columns["time"][90:] -= 100.0
    columns["time"][200:] += 1e6
    return [{name: float(column[k]) for name, column in columns.items()} for k in range(ROWS)]


def test_the_machine_decides_as_numpy() -> None:
    machine_run, reference, onsets = tracker(), by_numpy(), 0
    for k, row in enumerate(stream()):
        state, expected = machine_run.update(row), reference.update(row)
        # The functions of the machine and of NumPy differ by some units in the last place, and sums
        # by their order: an update is contractive, so that 1e-16 does not grow beyond 1e-10.
        np.testing.assert_allclose(state.theta, expected.theta, rtol=1e-10)
        np.testing.assert_allclose(state.covariance, expected.covariance, rtol=1e-7, atol=1e-13)
        assert str(state.alarm) == str(expected.alarm), k
        one, same = machine_run._population, reference._population
        np.testing.assert_array_equal(one.born, same.born)
        np.testing.assert_array_equal(one.drift, same.drift)
        np.testing.assert_array_equal(one.informed, same.informed)
        onsets += ((one.drift == one.rules.middle) & (one.born == k)).sum()
    assert one["turn"] > 20
    assert onsets > 3


def test_states_of_the_machine_are_those_of_numpy() -> None:
    """Some rows begin where the last one ended; the output of the last one may be an outlier."""
    machine_run, reference = tracker("x_next"), by_numpy("x_next")
    rows = stream(1)
    for row, later in pairwise(rows):
        row["x_next"] = row.pop("u")
        if later["time"] % 0.2 > 0.05:
            later["x"] = row["x_next"]
    rows[-1]["x_next"] = rows[-1].pop("u")
    for row in rows:
        state, expected = machine_run.update(row), reference.update(row)
        np.testing.assert_allclose(state.theta, expected.theta, rtol=1e-10)
        np.testing.assert_allclose(state.covariance, expected.covariance, rtol=1e-7, atol=1e-13)
    one, same = machine_run._population, reference._population
    assert one.layout.n == 1
    np.testing.assert_allclose(one.theta, same.theta, rtol=1e-9, atol=1e-12)


def test_all_levels_have_the_same_bits() -> None:
    runs = []
    for level in range(len(machine().levels())):
        run = tracker()
        population: Any = run._population
        track, _, sizes, rules = population._machine
        population._machine = track, population.formula.tape.at_level(level), sizes, rules
        runs.append(b"".join(run.update(row).covariance.tobytes() for row in stream()))
    assert len(set(runs)) == 1


def arguments() -> list[Any]:
    population: Any = tracker()._population
    _, tape, sizes, rules = population._machine
    assert sizes == SIZES
    estimate = np.empty(population.layout.estimate_size)
    return [tape, sizes, rules, np.array([0.1, 1.0, 0.2, 0.3, 0.0]), population.memory, estimate]


@pytest.mark.parametrize("position", [2, 3, 4, 5])
@pytest.mark.parametrize("change", ["short", "long", "integers", "strided"])
def test_the_door_refuses_other_arrays(position: int, change: str) -> None:
    given = arguments()
    array = given[position]
    given[position] = {
        "short": array[:-1],
        "long": np.append(array, 0.0),
        "integers": np.zeros(array.size, dtype=np.int64),
        "strided": np.repeat(array, 2)[::2],
    }[change]
    with pytest.raises((ValueError, BufferError)):
        machine().update_population(*given)


@pytest.mark.parametrize(
    "sizes",
    [
        (0, 2, 2, 2, 1, 0), (65, 2, 2, 2, 1, 0), (16, 3, 2, 2, 1, 0), (16, 2, 1, 2, 1, 0),
        (16, 2, 2, 3, 1, 0), (16, 2, 2, 2, 3, 0), (16, 2, 2, 2, -1, 0), (2**62, 2, 2, 2, 1, 0),
        (16, 2, 2, 2, 1), [16, 2, 2, 2, 1, 0], ("16", 2, 2, 2, 1, 0), (16, 2, 2, 2, 1, 2),
        (16, 2, 2, 2, 1, -1),
    ],
)  # fmt: skip
def test_the_door_refuses_other_sizes(sizes: Any) -> None:
    given = arguments()
    given[1] = sizes
    with pytest.raises((ValueError, TypeError)):
        machine().update_population(*given)


def test_the_door_refuses_what_it_must_not_write() -> None:
    given = arguments()
    given[4].flags.writeable = False
    with pytest.raises((ValueError, BufferError)):
        machine().update_population(*given)
    given = arguments()
    given[5] = given[4][: given[5].size]
    with pytest.raises(ValueError, match="overlaps"):
        machine().update_population(*given)
    with pytest.raises(ValueError, match="no tape"):
        machine().update_population(None, *given[1:])
    with pytest.raises(TypeError):
        machine().update_population(*given[:-1])


@pytest.mark.parametrize("filling", [0.0, np.nan, np.inf, -np.inf, 1e300, -1e300, 5e-324])
def test_no_content_leads_out_of_bounds(filling: float) -> None:
    for position in (2, 3, 4):
        given = arguments()
        given[position][:] = filling
        for _ in range(3):
            machine().update_population(*given)


def test_intervals_of_the_machine() -> None:
    rng = np.random.default_rng(1)
    for K in (1, 2, 16):
        weights = rng.exponential(size=K) ** 4
        mixture = Mixture(
            weights / weights.sum(), rng.standard_normal((K, 3)), rng.exponential(size=(K, 3)) ** 2
        )
        centre = mixture.weights @ mixture.means
        for level in (0.5, 0.95, 0.999):
            # The machine knows probabilities to 1.5e-7, which the density of the tail divides.
            np.testing.assert_allclose(
                mixture_reach(centre, mixture, level),
                reach_by_numpy(centre, mixture, level),
                rtol=1e-3 if level > 0.99 else 3e-5,
            )


def test_the_door_of_intervals() -> None:
    weights, means, out = np.ones(2), np.ones((2, 3)), np.empty(3)
    for wrong in (
        (weights[:1], means, means, out.copy(), 0.95, out),
        (weights, means, means[:1], out.copy(), 0.95, out),
        (weights, means, means, out[:2].copy(), 0.95, out),
        (weights, means, means, out, 0.95, out),
        (weights, means, means, out.copy(), "x", out),
    ):
        with pytest.raises((ValueError, TypeError)):
            machine().mixture_reach(*wrong)
    for strange in (np.nan, np.inf, -1.0, 0.0, 1e300):
        filled = np.full((2, 3), strange)
        machine().mixture_reach(weights * strange, filled, filled, filled[0].copy(), 0.95, out)
