"""Starts near the best minimum of a search that has found several."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from experiments.check.families import drawn
from miho import MIHOGN, Budget, CurveFit, Dataset
from miho.compiled.gauss_newton_candidates import Minima
from miho.models import FunctionModel
from miho.optim import Parameter, Space
from miho.optim.brackets import alike
from miho.optim.challenges import exchanged, scanned
from miho.optim.miho_gn_state import MIHOGNState
from miho.optim.oracle import Oracle
from miho.quantities import Array


def wave(x: Any, a: Any, w: Any) -> Any:
    return a * np.sin(w * x)


def peaks(x: Any, m: Any, a: Any, c: Any, w: Any, b: Any, d: Any, v: Any) -> Any:
    return m + a / (1 + ((x - c) / w) ** 2) + b * np.exp(-(((x - d) / v) ** 2))


def search(problem: CurveFit, best: Array, rng: np.random.Generator) -> tuple[MIHOGNState, Oracle]:
    """A search with one minimum (d,), in unit coordinates."""
    oracle = Oracle(problem, Budget())
    state = MIHOGN().start(oracle, rng)
    sums = np.full((1, state.level_rows.size), 30.0)
    state.minima = Minima(best[None], np.array([0.5]), sums, np.array([True]))
    return state, oracle


def test_values_are_exchanged_among_parameters_with_similar_bounds() -> None:
    """Two peaks of different shapes and bounds in each other's place; heights are linear."""
    rng = np.random.default_rng(1)
    box = [(-5.0, 5.0), (0.0, 20.0), (0.0, 100.0), (0.3, 40.0), (-5.0, 50.0), (5.0, 95.0),
           (0.2, 30.0)]  # fmt: skip
    true = [1.0, 5.0, 30.0, 5.0, 3.0, 70.0, 2.0]
    problem = drawn(peaks, [np.linspace(0, 100, 150)], true, 0.1, box, rng)
    space, width = problem.space, problem.space.high - problem.space.low
    best = (np.array([1.0, 3.0, 70.0, 2.0, 5.0, 30.0, 5.0]) - space.low) / width
    state, oracle = search(problem, best, rng)
    assert state.box.nonlinear.tolist() == [2, 3, 5, 6]
    assert alike(space, state.box.nonlinear) == [[2, 5], [3, 6]]
    assert alike(space, np.array([2, 3, 5])) == [], "two positions only"
    units = [replace(p, unit=p.name) for p in space.parameters]
    assert alike(Space(tuple(units)), state.box.nonlinear) == []
    starts = exchanged(state, oracle)
    assert starts is not None
    assert oracle.evaluations == 4 * 4
    assert space.low + width * starts[0] == pytest.approx(true, abs=0.3)


def test_no_start_is_a_point_at_which_the_model_has_no_value() -> None:
    def model(x: Any, a: float, c: float, w: float) -> Any:
        if c > 5:
            raise ValueError("c is too large")
        return np.array([a * math.exp(-(((v - c) / w) ** 2)) for v in x])

    rng = np.random.default_rng(2)
    x = np.linspace(0, 10, 40)
    data = Dataset("peak", {"x": x, "y": model(x, 2.0, 4.0, 1.0)}, {"x": "", "y": ""}, "y")
    ranges = {"a": 5.0, "c": 10.0, "w": 9.0}
    space = Space(tuple(Parameter(name, "", 0.1, high) for name, high in ranges.items()))
    problem = CurveFit(FunctionModel(model, columns=("x",), linear=("a",)), data, space)
    state, oracle = search(problem, np.array([0.4, 0.1, 0.5]), rng)
    state.spent_before = 2000.0
    starts = scanned(state, oracle)
    assert starts is not None
    assert (starts[:, 1] < 0.5).all()


def test_a_scan_finds_a_period_that_the_search_has_missed() -> None:
    rng = np.random.default_rng(0)
    x = np.linspace(0, 10, 60)
    problem = drawn(wave, [x], [1.0, 4.3], 0.1, [(0.0, 4.0), (0.0, 10.0)], rng)
    best = np.array([0.05, 0.9])  # the amplitude is linear, the angular frequency wrong
    state, oracle = search(problem, best, rng)
    assert scanned(state, oracle) is None, "a search without evaluations has no scan"
    state.spent_before = 400.0
    starts = scanned(state, oracle)
    assert starts is not None
    assert oracle.evaluations == 25 * 2, "the amplitude is solved for at each of 25 points"
    assert starts[0, 0] == pytest.approx(0.25, abs=0.05)
    assert 1 <= len(starts) <= 3
    assert starts[0, 1] == pytest.approx(0.43, abs=1 / 25)
    assert (np.abs(starts[:, 1] - 0.9) > 1 / 25).all()
    state.bracket += 1
    others = scanned(state, oracle)
    assert others is not None
    assert not np.isin(others[:, 1], starts[:, 1]).any()
