"""Many small fits in C: the door, the same bits on all levels, and Ctrl-C."""

from __future__ import annotations

import signal
import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from miho import CurveFit, Dataset, Parameter, Space
from miho.core import machine
from miho.fitting.datasets import Datasets
from miho.fitting.machine_fits import MachineFits, Optima
from miho.models import FunctionModel

pytestmark = pytest.mark.skipif(machine() is None, reason="built without a C compiler")

N, M = 50, 30
t = np.linspace(0, 3, N)
rng = np.random.default_rng(3)
TRUTH = np.stack([rng.uniform(0.5, 5, M), rng.uniform(0.3, 5, M), rng.uniform(-1, 1, M)], 1)
y = TRUTH[:, :1] * np.exp(-TRUTH[:, 1:2] * t) + TRUTH[:, 2:] + 0.02 * rng.standard_normal((M, N))
SPACE = Space(
    (
        Parameter("a", "", 0, 10),
        Parameter("b", "", 0.05, 20, scale="log"),
        Parameter("c", "", -5, 5),
    )
)
EVERYONE = np.arange(M)
SEED = (0, 0)


def decay(t: Any, a: Any, b: Any, c: Any) -> Any:
    return a * np.exp(-b * t) + c


def quiet(_: int) -> None:
    """No progress."""


def fits_of(datasets: Datasets, level: int = -1) -> MachineFits:
    dataset = Dataset("decay", {"t": t, "y": y[0]}, {"t": "", "y": ""}, "y")
    model = CurveFit(FunctionModel(decay, columns=("t",)), dataset, SPACE, compiled=False).model
    fits = MachineFits.of(model, SPACE, datasets)
    assert fits is not None
    return replace(fits, level=level)


def datasets(rows: Any = EVERYONE) -> Datasets:
    return Datasets.checked(t[None], y[rows].ravel(), np.arange(len(rows) + 1) * N)


def bits(found: Optima, at: Any = slice(None)) -> bytes:
    parts = found.thetas, found.squares, found.converged, found.covariance, found.flags
    return b"".join(np.ascontiguousarray(part[at]).tobytes() for part in parts)


@pytest.mark.parametrize("few", [1, 3, 32])
def test_all_levels_give_the_same_bits(few: int) -> None:
    levels = range(len(machine().levels()))
    found = [fits_of(datasets(), level).search(EVERYONE, SEED, quiet, few) for level in levels]
    assert found[0].converged.all()
    assert {bits(each) for each in found} == {bits(found[0])}


def test_a_dataset_does_not_depend_on_the_others_nor_on_how_its_columns_are_given() -> None:
    every = fits_of(datasets()).search(EVERYONE, SEED, quiet)
    turned = fits_of(datasets(EVERYONE[::-1])).search(EVERYONE, SEED, quiet)
    assert bits(turned, slice(None, None, -1)) == bits(every)
    alone = fits_of(datasets(np.array([7]))).search(np.array([0]), SEED, quiet)
    assert bits(alone) == bits(every, slice(7, 8))
    own = Datasets(np.tile(t, M)[None], y.ravel(), np.arange(M + 1) * N, shared=False)
    assert bits(fits_of(own).search(EVERYONE, SEED, quiet)) == bits(every)


def test_datasets_of_more_rows_than_a_chunk_are_fitted_alike() -> None:
    """Each is a short one, many times over: its optimum is the same."""
    times, few = 30, 4
    short = fits_of(datasets()).search(EVERYONE[:few], SEED, quiet)
    X, long = np.tile(t, times)[None], np.tile(y[:few], times).ravel()
    many = fits_of(Datasets.checked(X, long, np.arange(few + 1) * N * times))
    found = many.search(EVERYONE[:few], SEED, quiet)
    assert found.thetas == pytest.approx(short.thetas, rel=1e-6)
    assert found.squares == pytest.approx(times * short.squares, rel=1e-10)


def test_where_the_formula_has_no_value_there_is_none() -> None:
    data = datasets()
    X = np.full_like(data.X, 1e308)
    found = fits_of(Datasets(X, data.y, data.ends, shared=True)).descend(
        EVERYONE, np.full((1, 1, 3), 0.1)
    )
    assert np.isfinite(found.squares).all()  # the decay has ended
    found = fits_of(Datasets(-X, data.y, data.ends, shared=True)).search(EVERYONE, SEED, quiet)
    assert np.isnan(found.thetas).all()
    assert np.isinf(found.squares).all()
    assert not found.converged.any()


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (0, None, "first argument is no tape"),
        (1, np.zeros((2, N)), "X has another type or shape"),
        (1, np.zeros((1, N - 1)), "not as long as X"),
        (3, np.arange(M + 1) * N + 1, "ends do not match the rows"),
        (3, np.array([0, M * N, 0, M * N]), "a dataset is empty"),
        (3, np.array([0, 5, np.iinfo(np.int64).min, -1, M * N]), "a dataset is empty"),
        (4, False, "X and y differ in length"),
        (5, (SPACE.low,), "box is no record"),
        (
            5,
            (SPACE.low, SPACE.high, np.zeros(3, bool), np.array([1, 0])),
            "positions of linear parameters",
        ),
        (
            5,
            (SPACE.low, SPACE.high, np.zeros(3, bool), np.array([3])),
            "positions of linear parameters",
        ),
        (6, (np.zeros((1, 0, 3)), 1, False), "there are no starts"),
        (6, (np.zeros((2, 1, 3)), 1, True), "for each dataset"),
        (6, (np.zeros((2, 1, 2)), 1, False), "starts has another type or shape"),
        (7, np.array([M]), "which has an index without a dataset"),
        (7, np.array([-1]), "which has an index without a dataset"),
        (8, np.zeros((2, 3)), "thetas has another type or shape"),
        (11, np.zeros((1, 2), bool), "flags has another type or shape"),
    ],
)
def test_the_door_refuses(place: int, value: object, message: str) -> None:
    one = np.zeros(1, dtype=np.int64)
    ends = np.empty((1, 3)), np.empty(1), np.empty((1, 3, 3)), np.zeros((1, 3), bool)
    arguments = [*fits_of(datasets())._given, (np.ones((1, 1, 3)), 1, False), one, *ends]
    machine().fit_many(*arguments)
    arguments[place] = value
    with pytest.raises((ValueError, TypeError), match=message):
        machine().fit_many(*arguments)


@pytest.mark.parametrize("place", [7, 8, 9])
def test_results_do_not_overwrite_what_was_checked(place: int) -> None:
    one, memory = np.zeros(1, dtype=np.int64), np.zeros(3)
    arrays = {
        7: memory[:1].view(np.int64),
        8: memory[None],
        9: memory[:1],
    }
    ends = [np.empty((1, 3)), np.empty(1), np.empty((1, 3, 3)), np.zeros((1, 3), bool)]
    arguments = [*fits_of(datasets())._given, (np.ones((1, 1, 3)), 1, False), one, *ends]
    for k in {7, 8, 9} - {place}:
        arguments[k] = arrays[k]
    with pytest.raises(ValueError, match="overlaps another one"):
        machine().fit_many(*arguments)


INTERRUPTED = """
import numpy as np
import miho
t = np.linspace(0, 3, 50)
y = np.random.default_rng(0).standard_normal((400_000, 50))
print("ready", flush=True)
try:
    miho.fit_many(lambda t, a, b, c, d: a * np.exp(-b * t) + c * np.exp(-d * t), t, y,
                  {"a": (0, 10), "b": (0, 20), "c": (-5, 5), "d": (0, 20)})
    print("finished", flush=True)
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGINT for another process")
def test_ctrl_c_ends_it_at_once() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == "ready\n"
        while "datasets" not in (line := process.stderr.readline()):
            assert line, "the fits ended before they said how far they are"
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == "interrupted\n"
    assert process.returncode == 0
