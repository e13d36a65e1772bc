"""Starts near the best minimum of a search that has found several."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from experiments.check.families import drawn
from miho import MIHOGN, Budget
from miho.compiled.gauss_newton_candidates import Minima
from miho.optim import Parameter, Space
from miho.optim.challenges import exchanged, scanned
from miho.optim.oracle import Oracle


def wave(x: Any, a: Any, w: Any) -> Any:
    return a * np.sin(w * x)


def test_values_are_exchanged_among_parameters_with_equal_bounds() -> None:
    """Two peaks and an offset; the smallest bracket has one start."""
    names, rng = ("m", "a", "c", "w", "b", "d", "v"), np.random.default_rng(1)
    highs = (1, 5, 100, 9, 5, 100, 9)
    space = Space(tuple(Parameter(k, "", 0, high) for k, high in zip(names, highs, strict=True)))
    assert space.alike == [[1, 4], [2, 5], [3, 6]]
    assert Space(space.parameters[:5]).alike == [], "two heights only"
    units = [replace(p, unit=p.name) for p in space.parameters]
    assert Space(tuple(units)).alike == []
    best = np.arange(7.0)
    for n in (1, 40):
        starts = exchanged(best, space, n, rng)
        assert starts[0].tolist() == [0, 4, 5, 6, 1, 2, 3]
        assert not (starts == best).all(axis=1).any()
        assert (starts[:, 0] == 0).all()
        for group in space.alike:
            assert (np.sort(starts[:, group], axis=1) == best[group]).all()
    assert len(np.unique(starts, axis=0)) == 7, "all exchanges but none"


def test_a_scan_finds_a_period_that_the_search_has_missed() -> None:
    rng = np.random.default_rng(0)
    x = np.linspace(0, 10, 60)
    problem = drawn(wave, [x], [1.0, 4.3], 0.1, [(0.0, 4.0), (0.0, 10.0)], rng)
    oracle = Oracle(problem, Budget())
    state = MIHOGN().start(oracle, rng)
    best = np.array([0.05, 0.9])  # the amplitude is linear, the angular frequency wrong
    state.minima = Minima(best[None], np.array([0.5]), np.full((1, 2), 30.0), np.array([True]))
    assert scanned(state, oracle) is None, "a search without evaluations has no scan"
    state.spent_before = 400.0
    starts = scanned(state, oracle)
    assert starts is not None
    assert oracle.evaluations == 32
    assert (starts[:, 0] == 0.05).all()
    assert 1 <= len(starts) <= 3
    assert starts[0, 1] == pytest.approx(0.43, abs=1 / 32)
    assert (np.abs(starts[:, 1] - 0.9) > 1 / 32).all()
    state.bracket += 1
    others = scanned(state, oracle)
    assert others is not None
    assert not np.isin(others[:, 1], starts[:, 1]).any()
