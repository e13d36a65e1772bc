"""Steps of mutation in the machine: a plain loop in NumPy decides alike, and what is refused."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from miho.compiled import Steps
from miho.core import Instruction, Tape, machine
from miho.models.formula_tape import tape_of
from miho.models.symbolic import argument, trace
from miho.vehicle.models import Pacejka

Array = NDArray[np.float64]
pytestmark = pytest.mark.skipif(machine() is None, reason="the machine was not built")

LOW, HIGH = np.array([2, 1, 1000, -0.05, -500.0]), np.array([40, 2.5, 6000, 0.05, 500.0])
FIRST = 64


@dataclass
class Climbed:
    """Everything that a call gives or changes."""

    P: Array
    L: Array
    counts: tuple[int, ...]
    at: list[int]
    losses: Array
    thetas: Array

    @property
    def bits(self) -> tuple[Any, ...]:
        """To compare with another one, NaN included."""
        arrays = self.P, self.L, self.losses, self.thetas
        return self.counts, tuple(self.at), *(array.tobytes() for array in arrays)


def climbed(
    tape: Tape, X: Array, y: Array, steps: Steps, target: float = -math.inf, level: int = -1
) -> Climbed:
    """A call on copies of P and L."""
    steps = steps._replace(P=steps.P.copy(), L=steps.L.copy())
    most, d = steps.first.shape[0] * (len(steps.sigma) + 1), steps.first.shape[1]
    at, losses, thetas = np.empty(most, np.int64), np.empty(most), np.empty((most, d))
    counts = machine().climb(
        tape.at_level(level), X, y, FIRST, steps, np.inf, target, at, losses, thetas
    )
    k = counts[1]
    return Climbed(steps.P, steps.L, counts, at[:k].tolist(), losses[:k], thetas[:k])


def plain(tape: Tape, X: Array, y: Array, steps: Steps, target: float = -math.inf) -> Climbed:
    """The same as a loop in NumPy, without early stopping."""
    P, L, best = steps.P.copy(), steps.L.copy(), np.inf
    at: list[int] = []
    listed: list[tuple[float, Array]] = []
    evaluations = nans = infinities = 0
    for k in range(len(steps.sigma) + 1):
        for i in range(len(P)):
            mutant = steps.first[i]
            if k:
                mutant = np.clip(P[i] + steps.sigma[k - 1] * steps.noise[k - 1, i], *steps.bounds)
            with np.errstate(all="ignore"):
                loss = float(np.mean((tape.by_numpy(mutant, X)[0] - y) ** 2))
            evaluations += 1
            nans += math.isnan(loss)
            infinities += loss == np.inf
            if loss < L[i]:
                P[i], L[i] = mutant, loss
                if loss < best:
                    best = loss
                    at.append(evaluations)
                    listed.append((loss, mutant.copy()))
        if best <= target:
            break
    counts = (k + 1, len(at), nans, infinities)
    losses, thetas = np.array([a for a, _ in listed]), np.array([b for _, b in listed])
    return Climbed(P, L, counts, at, losses, thetas)


def tire(
    seed: int, rows: int = 700, n: int = 6, more: int = 40
) -> tuple[Tape, Array, Array, Steps]:
    """A noisy tire, random parents and annealed noise."""
    rng = np.random.default_rng(seed)
    tapes = Pacejka().tapes
    assert tapes is not None
    X = rng.uniform(-0.22, 0.22, (1, rows))
    y = Pacejka().predict(np.array([[12.0, 1.4, 3000.0, 0.01, 80.0]]), X[0])[0]
    y += 100 * rng.standard_normal(rows)
    P = LOW + (HIGH - LOW) * rng.random((n, 5))
    first = np.clip(P + 0.1 * (HIGH - LOW) * rng.standard_normal(P.shape), LOW, HIGH)
    sigma = (HIGH - LOW) * np.linspace(0.2, 0.01, more)[:, None]
    L = tapes[0].mean_squares(P, X, y, FIRST)
    L[0] = np.inf
    return tapes[0], X, y, Steps(first, P, L, rng.standard_normal((more, n, 5)), sigma, (LOW, HIGH))


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("rows", [1, 63, 65, 700])
def test_a_plain_loop_decides_alike(seed: int, rows: int) -> None:
    """The same mutants are accepted and listed; their losses differ by rounding."""
    problem = tire(seed, rows)
    found, expected = climbed(*problem), plain(*problem)
    assert found.counts == expected.counts
    assert found.at == expected.at
    np.testing.assert_array_equal(found.P, expected.P)
    np.testing.assert_array_equal(found.thetas, expected.thetas)
    np.testing.assert_allclose(found.losses, expected.losses, rtol=1e-11)
    np.testing.assert_allclose(found.L, expected.L, rtol=1e-11)


@pytest.mark.parametrize("seed", range(4))
def test_early_stopping_and_levels_change_no_bit(seed: int) -> None:
    tape, X, y, steps = tire(seed)
    bits = {
        climbed(tape, X, y, steps._replace(early_stopping=stops), level=level).bits
        for stops in (False, True)
        for level in range(len(machine().levels()))
    }
    assert len(bits) == 1


def test_rows_are_the_same_bits_alone_and_losses_those_of_a_batch() -> None:
    tape, X, y, steps = tire(1)
    together = climbed(tape, X, y, steps)
    for i in range(len(steps.P)):
        row = slice(i, i + 1)
        noise = np.ascontiguousarray(steps.noise[:, row])
        part = steps._replace(first=steps.first[row], P=steps.P[row], L=steps.L[row], noise=noise)
        alone = climbed(tape, X, y, part)
        assert alone.P.tobytes() == together.P[row].tobytes()
        assert alone.L.tobytes() == together.L[row].tobytes()
    assert together.losses.tolist() == tape.mean_squares(together.thetas, X, y, FIRST).tolist()
    assert together.L.tolist() == tape.mean_squares(together.P, X, y, FIRST).tolist()


def test_the_step_that_reaches_the_target_is_the_last() -> None:
    problem = tire(2)
    whole = climbed(*problem)
    for target in whole.losses[[2, -1]].tolist():
        found, expected = climbed(*problem, target=target), plain(*problem, target=target + 1e-6)
        assert found.counts == expected.counts
        assert found.at == expected.at == whole.at[: len(found.at)]
        np.testing.assert_array_equal(found.P, expected.P)
        assert found.losses.min() == target


def test_losses_that_are_not_finite_are_counted() -> None:
    """sqrt(a + x) / b: NaN for a below -x, infinite where b is 0."""
    x, a, b = (argument(name) for name in ("x", "a", "b"))
    tape = tape_of([trace(lambda x, a, b: np.sqrt(a + x) / b, x, a, b)], [x], [a, b])
    rng = np.random.default_rng(5)
    X, low, high = rng.uniform(0, 1, (1, 100)), np.array([-1.0, 0.0]), np.array([1.0, 2.0])
    P = rng.uniform(low, high, (5, 2))
    steps = Steps(P, P, np.full(5, np.inf), rng.standard_normal((60, 5, 2)), np.ones((60, 2)),
                  (low, high), early_stopping=False)  # fmt: skip
    found, expected = climbed(tape, X, X[0], steps), plain(tape, X, X[0], steps)
    assert found.counts == expected.counts
    assert min(found.counts[2:]) > 5
    np.testing.assert_array_equal(found.P, expected.P)
    stopped = climbed(tape, X, X[0], steps._replace(early_stopping=True))
    assert stopped.P.tobytes() == found.P.tobytes()
    assert stopped.at == found.at


def test_no_rows_and_no_further_steps() -> None:
    tape, X, y, steps = tire(0, n=3, more=0)
    assert climbed(tape, X, y, steps).counts[0] == 1
    none = steps._replace(first=steps.first[:0], P=steps.P[:0], L=steps.L[:0],
                          noise=steps.noise[:, :0])  # fmt: skip
    assert climbed(tape, X, y, none).counts == (1, 0, 0, 0)


TAPE, X, Y, STEPS = tire(3, rows=20, n=2, more=3) if machine() else (None,) * 4
FROZEN = np.ones((2, 5))
FROZEN.flags.writeable = False
BAD_STEPS: dict[str, dict[str, Any]] = {
    "first": {"first": np.ones((3, 5))},
    "first of other parameters": {"first": np.ones((2, 4))},
    "P": {"P": np.ones((2, 4))},
    "P of whole numbers": {"P": np.ones((2, 5), np.int64)},
    "P in columns": {"P": np.ones((5, 2)).T},
    "P read-only": {"P": FROZEN},
    "L": {"L": np.ones(3)},
    "noise of other rows": {"noise": np.ones((3, 1, 5))},
    "noise of other steps": {"noise": np.ones((2, 2, 5))},
    "noise": {"noise": np.ones((3, 10))},
    "sigma": {"sigma": np.ones((3, 4))},
    "bounds[0]": {"bounds": (LOW[:4], HIGH)},
    "bounds[1]": {"bounds": (LOW, HIGH.astype(np.float32))},
    "no pair": {"bounds": (LOW,)},
}
BAD: dict[str, dict[int, Any]] = {
    "X of other inputs": {1: np.ones((2, 20))},
    "X of one axis": {1: np.ones(20)},
    "y": {2: np.ones(19)},
    "no rows": {1: np.ones((1, 0)), 2: np.ones(0)},
    "no first block": {3: 0},
    "no first block at all": {3: -1},
    "too few places": {7: np.empty(7, np.int64)},
    "places of numbers": {7: np.empty(8)},
    "losses": {8: np.empty(9)},
    "thetas": {9: np.empty((8, 4))},
}


def arguments() -> list[Any]:
    """What is accepted."""
    assert STEPS is not None
    assert TAPE is not None
    steps = STEPS._replace(P=STEPS.P.copy(), L=STEPS.L.copy())
    found = np.empty(8, np.int64), np.empty(8), np.empty((8, 5))
    return [TAPE.in_machine, X, Y, FIRST, steps, math.inf, -math.inf, *found]


def test_good_arguments_are_accepted() -> None:
    assert machine().climb(*arguments())[0] == 4


@pytest.mark.parametrize("fault", BAD_STEPS)
def test_bad_steps_are_refused(fault: str) -> None:
    given = arguments()
    given[4] = given[4]._replace(**BAD_STEPS[fault])
    with pytest.raises((ValueError, TypeError, BufferError)):
        machine().climb(*given)


@pytest.mark.parametrize("fault", BAD)
def test_bad_arguments_are_refused(fault: str) -> None:
    given = arguments()
    for k, value in BAD[fault].items():
        given[k] = value
    with pytest.raises(ValueError, match="climb: "):
        machine().climb(*given)


def test_what_is_no_number_no_record_or_no_tape_is_refused() -> None:
    for k, value in ((0, None), (3, "1"), (4, (1, 2)), (5, None), (6, "inf")):
        given = arguments()
        given[k] = value
        with pytest.raises((TypeError, ValueError)):
            machine().climb(*given)
    with pytest.raises(TypeError, match="10 arguments"):
        machine().climb(*arguments()[:9])
    two = Tape(1, 2, 3, 5, 5, (), (), (Instruction("COPY", (0,), (1,)),) * 2, ())
    with pytest.raises(ValueError, match="a tape with one result"):
        machine().climb(two.in_machine, *arguments()[1:])


def test_arrays_that_overlap_are_refused() -> None:
    given = arguments()
    given[8] = given[7].view(float)
    with pytest.raises(ValueError, match="overlaps another one"):
        machine().climb(*given)
