"""The search of the machine takes the decisions of the Python functions, and the same bits.

Python's steps are here given the machine's sums, exponential and logarithm: all else is arithmetic
in the same order, which leaves no last bit to differ. With NumPy's sums last bits do.
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import tests.core.python_bracket as python_bracket
from baselines.problems import PublishedModel, published_fit, published_names
from miho import CurveFit, Dataset, Parameter, Space
from miho.compiled import gauss_newton, triangular
from miho.compiled.gauss_newton_candidates import SIZE
from miho.compiled.phases import PAUSED
from miho.core import Instruction, Tape, machine
from miho.models import FunctionModel
from miho.optim import (
    MIHOGN,
    Budget,
    BudgetExhausted,
    LeastSquaresProblem,
    Oracle,
    gauss_newton_blocks,
)
from miho.optim.miho_gn_state import MIHOGNState
from tests.optim.decays import fit

Array = NDArray[np.float64]
pytestmark = pytest.mark.skipif(machine() is None, reason="the machine was not built")


def product_sum(a: Array, b: Array) -> float:
    """The sum of products as `miho/core/columns.h` has it: eight sums, then these in pairs."""
    terms = np.zeros(-(-a.size // 8) * 8)
    terms[: a.size] = a * b
    s = np.zeros(8)
    for row in terms.reshape(-1, 8):
        s += row
    return float(((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7])))


def square_sum(r: Array, count: int) -> float:
    return product_sum(r[:count], r[:count])


def fold(T: Array, columns: Array, count: int, n: int) -> None:
    rows = columns[:n, :count]
    for k in range(n):
        v, diagonal = rows[k], T[k, k]
        square = product_sum(v, v)
        if square < triangular.SMALLEST:
            continue
        norm = -math.copysign(math.sqrt(diagonal * diagonal + square), diagonal)
        first = diagonal - norm
        factor = 2.0 / (first * first + square)
        T[k, k] = norm
        for j in range(k + 1, n):
            product = (first * T[k, j] + product_sum(v, rows[j])) * factor
            T[k, j] -= product * first
            rows[j] -= product * v


def by_machine(operation: str) -> Any:
    """An elementary function of one number by the machine."""
    tape = Tape(1, 1, 2, 0, 0, (), (), (Instruction(operation, (0,), (1,)),), ())
    return lambda x: float(tape.evaluate(np.empty((1, 0)), np.array([[x]])).item())


@contextmanager
def python_steps(sums: bool = True) -> Iterator[None]:
    """Problems of the machine are searched by the Python functions, which sum as it does."""
    functions = {name: getattr(math, name) for name in ("sqrt", "isfinite", "inf")}
    with pytest.MonkeyPatch.context() as patch, np.errstate(all="ignore"):
        by_python = partial(partial, python_bracket.run_bracket)
        patch.setattr(gauss_newton_blocks, "bracket_of", by_python)
        if sums:
            exact = SimpleNamespace(exp=by_machine("EXP"), log=by_machine("LOG"), **functions)
            patch.setattr(gauss_newton, "math", exact)
            patch.setattr(python_bracket, "square_sum", square_sum)
            for module in (gauss_newton, python_bracket, triangular):
                patch.setattr(module, "fold", fold)
            patch.setattr(gauss_newton, "solve_in_box", triangular.solve_in_box)
        yield


def searched(
    problem: LeastSquaresProblem, method: MIHOGN, seed: int, evaluations: int
) -> tuple[MIHOGNState, Oracle]:
    """A search to its end, or that of the budget."""
    oracle = Oracle(problem, Budget(evaluations=evaluations))
    with suppress(BudgetExhausted):
        method.run(oracle, np.random.default_rng(seed))
    state = oracle.state
    assert isinstance(state, MIHOGNState)
    return state, oracle


def assert_same(one: tuple[MIHOGNState, Oracle], other: tuple[MIHOGNState, Oracle]) -> None:
    """The same evaluations, improvements, ends and states, to the last bit."""
    (state, oracle), (expected, reference) = one, other
    assert oracle.evaluations == reference.evaluations
    assert oracle.trace.evaluations == reference.trace.evaluations
    assert oracle.trace.loss == reference.trace.loss
    np.testing.assert_array_equal(oracle.trace.theta, reference.trace.theta)
    assert oracle.meter.rejected == reference.meter.rejected
    agreements = (each.starts.agreement(each.best) for each in (oracle, reference))
    assert repr(next(agreements)) == repr(next(agreements))
    np.testing.assert_array_equal(state.place, expected.place)
    size = int(state.place[SIZE])
    for k in range(3):
        np.testing.assert_array_equal(state.candidates[k][:size], expected.candidates[k][:size])
    for known, wanted in zip(state.minima, expected.minima, strict=True):
        np.testing.assert_array_equal(known, wanted)
    assert state.rng.bit_generator.state == expected.rng.bit_generator.state
    assert state.finished == expected.finished


def assert_python_takes_the_same_steps(
    problem: LeastSquaresProblem, method: MIHOGN, seeds: int = 2, evaluations: int = 300
) -> None:
    for seed in range(seeds):
        by_machine = searched(problem, method, seed, evaluations)
        with python_steps():
            by_python = searched(problem, method, seed, evaluations)
        assert_same(by_machine, by_python)


@pytest.mark.parametrize("size", [1e-154, 1e-158])
def test_derivatives_whose_squares_are_no_normal_numbers(size: float) -> None:
    """They are finite, and the search takes the same steps with or without the machine."""
    data = fit().dataset

    def decay(t: Array, a: float, b: float, c: float) -> Any:
        return a * np.exp(-b * t) + size * c

    problem = CurveFit(FunctionModel(decay, columns=("t",)), data, fit().space)
    assert problem.kernel is not None and problem.kernel.rows is not None
    assert_python_takes_the_same_steps(problem, MIHOGN(projection_period=0))
    assert not searched(problem, MIHOGN(projection_period=0), 0, 300)[1].meter.rejected


def at_level(problem: CurveFit, level: int) -> CurveFit:
    """The same problem, whose tapes are for a level of the processor's instructions."""
    other = replace(problem)
    kernel = other.kernel
    assert kernel is not None
    tapes = [tape.at_level(level) for tape in (kernel.taped.value, kernel.taped.slopes)]
    vars(kernel.taped)["rows"] = kernel.taped.rows._replace(tapes=tapes)
    return other


@pytest.mark.parametrize("level", range(len(machine().levels()) if machine() else 0))
def test_the_same_bits_on_every_level_of_instructions(level: int) -> None:
    for problem in (fit(linear=()), fit(5000), published("osborne2"), published("gauss1")):
        assert problem is not None
        usual = searched(problem, MIHOGN(), 1, 200)
        assert_same(searched(at_level(problem, level), MIHOGN(), 1, 200), usual)


@pytest.mark.parametrize("linear", [(), ("a", "c")], ids=["stepping", "projecting"])
def test_with_numpys_own_sums_last_bits_differ_alone(linear: tuple[str, ...]) -> None:
    """The evaluations are the same as long as rounding decides nothing: without last digits.

    A sum of 600 terms is rounded by some 1e-15 of itself; a thousand times that is to spare.
    """
    method = MIHOGN(max_brackets=4, final_tolerance=1e-8)
    for seed in range(4):
        state, oracle = searched(fit(linear=linear), method, seed, 500)
        with python_steps(sums=False):
            expected, reference = searched(fit(linear=linear), method, seed, 500)
        assert oracle.evaluations == reference.evaluations
        assert oracle.trace.evaluations == reference.trace.evaluations
        np.testing.assert_allclose(oracle.trace.loss, reference.trace.loss, rtol=1e-12)
        np.testing.assert_array_equal(state.place, expected.place)


METHODS = [
    MIHOGN(),
    MIHOGN(max_secants=0),
    MIHOGN(projection_period=0),
    MIHOGN(projection_period=1),
    MIHOGN(scale_decay=1.0),
    MIHOGN(patience=0.5),
    MIHOGN(eta=2, steps_per_rung=1, leader_steps=2, max_step=0.1, damping=1.0),
]


@pytest.mark.parametrize("method", METHODS, ids=range(len(METHODS)))
@pytest.mark.parametrize("linear", [(), ("a", "c")], ids=["stepping", "projecting"])
def test_settings_of_the_method(method: MIHOGN, linear: tuple[str, ...]) -> None:
    for N in (7, 60, 1500):
        assert_python_takes_the_same_steps(fit(N, linear=linear), method)


BOXES = {
    "optimum outside": ((0.0, 1.5), (0.01, 100.0), (0.6, 10.0)),
    "all but one at a bound": ((5.0, 6.0), (0.01, 100.0), (1.0, 2.0)),
    "overflows": ((0.0, 1e200), (1e-100, 1e100), (-1e200, 1e200)),
    "narrow": ((2.0, 2.0 + 1e-9), (0.5, 0.5 + 1e-9), (0.3, 0.3 + 1e-9)),
}


@pytest.mark.parametrize("name", BOXES)
@pytest.mark.parametrize("linear", [(), ("a", "c")], ids=["stepping", "projecting"])
def test_bounds_and_values_that_cannot_be_used(name: str, linear: tuple[str, ...]) -> None:
    a, b, c = BOXES[name]
    space = Space(
        (Parameter("a", "V", *a), Parameter("b", "1/s", *b, scale="log"), Parameter("c", "V", *c))
    )
    for method in (MIHOGN(max_brackets=6), MIHOGN(max_brackets=6, projection_period=1)):
        assert_python_takes_the_same_steps(fit(300, space, linear=linear), method)


def published(name: str) -> CurveFit | None:
    """A published fit in a box around its optimum; None where the formula is no tape."""
    given = published_fit(name)
    model = PublishedModel(given.model)
    if model.tapes is None:
        return None
    space = []
    for unit, value in zip(model.parameters.items(), given.optimum, strict=True):
        size = abs(value) or 1.0
        if value > 0:
            space.append(Parameter(*unit, value / 30, value * 30, scale="log"))
        else:
            space.append(Parameter(*unit, value - 5 * size, value + 5 * size))
    return CurveFit(model, given.dataset, Space(tuple(space)), compiled=True)


@pytest.mark.parametrize("name", published_names())
def test_published_fits(name: str) -> None:
    problem = published(name)
    if problem is None or problem.kernel is None or problem.kernel.rows is None:
        pytest.skip("no formula of the machine")
    assert_python_takes_the_same_steps(problem, MIHOGN(), seeds=1, evaluations=200)


def undetermined(t: Any, *, a: Any, b: Any, k: Any) -> Any:
    return a * b * np.exp(-k * t)


def test_parameters_that_the_data_do_not_determine() -> None:
    t = np.linspace(0, 3, 200)
    y = undetermined(t, a=2.0, b=1.0, k=0.5) + 0.01 * np.random.default_rng(3).normal(size=200)
    space = Space(tuple(Parameter(name, "-", 0.1, 10.0) for name in "abk"))
    data = Dataset("undetermined", {"t": t, "y": y}, {"t": "-", "y": "-"}, "y")
    problem = CurveFit(FunctionModel(undetermined), data, space, compiled=True)
    for method in (MIHOGN(), MIHOGN(projection_period=1)):
        assert_python_takes_the_same_steps(problem, method, evaluations=150)


def root(t: Any, *, a: Any, b: Any) -> Any:
    return a * np.sqrt(b - t)


def test_steps_that_end_at_values_that_are_none() -> None:
    """The best b is beyond the last row, where the root has no value: damping grows to its end."""
    t = np.linspace(0, 3, 60)
    data = Dataset("root", {"t": t, "y": np.sqrt(np.abs(2.5 - t))}, {"t": "-", "y": "-"}, "y")
    space = Space((Parameter("a", "-", 0.1, 10.0), Parameter("b", "-", 0.1, 10.0)))
    problem = CurveFit(FunctionModel(root), data, space, compiled=True)
    patient = MIHOGN(patience=1e9, tolerance=1e-300, final_tolerance=1e-300)
    assert_python_takes_the_same_steps(problem, patient, seeds=1, evaluations=600)


@pytest.mark.parametrize("evaluations", range(1, 41))
def test_a_search_cut_anywhere_goes_on_as_if_it_had_not_been(evaluations: int) -> None:
    """Also where its state was pickled, and where the other one of the two goes on."""
    method, problem = MIHOGN(max_brackets=5), fit(1000)
    whole = searched(problem, method, 1, 400)
    state, cut = searched(problem, method, 1, evaluations)
    with python_steps():
        assert_same((state, cut), searched(problem, method, 1, evaluations))
    for _ in range(2):
        saved, meter = pickle.loads(pickle.dumps((state, cut.meter)))
        resumed = Oracle(problem, Budget(evaluations=400), meter=meter)
        if _ == 0:
            method.resume(resumed, saved)
        else:
            with python_steps():
                method.resume(resumed, saved)
        assert_same((saved, resumed), whole)


def test_a_target_ends_a_search_at_its_evaluation() -> None:
    problem = fit()
    _, free = searched(problem, MIHOGN(), 0, 500)
    for target in free.trace.loss:
        oracle = Oracle(problem, Budget(target=target))
        with pytest.raises(BudgetExhausted):
            MIHOGN().run(oracle, np.random.default_rng(0))
        assert oracle.best == target


CALL = [
    "calls", "kept", "X", "y", "numbers", "counts", "R", "stored", "place", "order", "box",
    "level_rows", "minima", "settings", "most", "best", "target", "at", "losses", "thetas",
    "tally", "room",
]  # fmt: skip


def a_call() -> dict[str, Any]:
    """The arguments of the first block of a search, of two candidates that store derivatives."""
    problem = fit(600, linear=("a", "c"))
    taken: dict[str, Any] = {}

    def bracket(*arguments: Any) -> int:
        taken.update(zip(CALL[4:], arguments, strict=True))
        raise BudgetExhausted

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("miho.optim.gauss_newton_blocks.bracket_of", lambda rows: bracket)
        searched(problem, MIHOGN(), 0, 100)
    assert problem.kernel is not None
    rows = problem.kernel.rows
    assert rows is not None
    return dict(zip(CALL, [rows.calls, rows.tapes, rows.X, rows.y], strict=False)) | taken


def run(arguments: dict[str, Any]) -> int:
    return int(machine().run_bracket(*(arguments[name] for name in CALL)))


def with_item(array: Any, at: int, value: Any) -> Any:
    changed = array.copy()
    changed[at] = value
    return changed


OTHER_TAPE = Tape(1, 1, 2, 0, 0, (), (), (Instruction("EXP", (0,), (1,)),), ())
BAD: dict[str, Any] = {
    "calls": [np.zeros(3, np.int64), np.zeros(4), None],
    "kept": [[], [1], 3, [OTHER_TAPE.in_machine] * 2],
    "X": [np.zeros((1, 599)), np.zeros((2, 600)), np.zeros(600), np.zeros((1, 600), np.float32)],
    "y": [np.zeros(599), np.zeros((1, 600))],
    "numbers": [lambda a: a[:, :-1].copy(), lambda a: a[:, ::-1], lambda a: a[1:].copy()],
    "counts": [lambda a: a[:-1].copy(), lambda a: a.astype(float), lambda a: a[:, 1:].copy()],
    "R": [lambda a: a[:-1].copy(), lambda a: a[:, 1:].copy(), lambda a: a[0].copy()],
    "stored": [lambda a: a.astype(int), lambda a: a[:, None]],
    "place": [
        lambda a: a[1:].copy(), lambda a: with_item(a, 1, 99), lambda a: with_item(a, 1, -1),
        lambda a: with_item(a, 2, 10_000), lambda a: with_item(a, 3, 10_000),
        lambda a: with_item(a, 2, -1), lambda a: with_item(a, 3, -1),
        lambda a: with_item(a, 4, 7), lambda a: with_item(a, 4, -5),
    ],
    "order": [lambda a: a[1:].copy()],
    "box": [
        (), None, [], lambda a: a[:6], lambda a: a._replace(low=a.low[1:]),
        lambda a: a._replace(log=a.log.astype(float)),
        lambda a: a._replace(linear=np.array([0, 3])),
        lambda a: a._replace(linear=np.array([0, -1])),
        lambda a: a._replace(linear=np.array([0, 0])),
        lambda a: a._replace(nonlinear=np.array([5])),
        lambda a: a._replace(nonlinear=np.array([0, 1])),
    ],
    "level_rows": [
        np.empty(0, np.int64), lambda a: a[::-1].copy(), lambda a: a + 1,
        lambda a: with_item(a, 0, 0),
    ],
    "minima": [(), lambda a: a._replace(x=np.zeros((0, 2))), lambda a: a._replace(loss=np.ones(3))],
    "settings": [(), lambda a: a[:5], lambda a: a._replace(eta=0), lambda a: a._replace(eta=1),
                 lambda a: a._replace(steps=1.5), lambda a: a._replace(slope_cost=-1),
                 lambda a: a._replace(reach="far")],
    "most": [1.5, None, 2**70],
    "best": ["low", None],
    "target": [None],
    "at": [lambda a: a[:3].copy(), lambda a: a.astype(float)],
    "losses": [lambda a: a[:3].copy()],
    "thetas": [lambda a: a[:, :2].copy(), lambda a: a[:3].copy()],
    "tally": [np.zeros(4, np.int64), np.ones(5, np.int64)],
    "room": [lambda a: a[:100].copy(), lambda a: np.zeros(a.size, np.float32)],
}  # fmt: skip


@pytest.mark.parametrize("name", CALL)
def test_arguments_that_would_lead_out_of_an_array_are_refused(name: str) -> None:
    """And leave all arrays as they are."""
    good = a_call()
    before = pickle.dumps((good["numbers"], good["counts"], good["place"]))
    for bad in BAD[name]:
        value = bad(good[name]) if callable(bad) else bad
        with pytest.raises((ValueError, TypeError, OverflowError, BufferError, IndexError)):
            run(good | {name: value})
    assert pickle.dumps((good["numbers"], good["counts"], good["place"])) == before
    for written in ("numbers", "counts", "R", "place", "losses"):
        frozen = good[written].copy()
        frozen.flags.writeable = False
        with pytest.raises((ValueError, BufferError)):
            run(good | {written: frozen})
    rows = good["level_rows"][0]
    for stored in (good["stored"][:10].copy(), np.empty(0)):
        with pytest.raises(ValueError, match="stored is too small"):
            run(good | {"stored": stored, "place": with_item(good["place"], 4, rows)})
    with pytest.raises(TypeError):
        machine().run_bracket(*list(good.values())[:-1])
    assert run(good | {"most": 2 * 600}) == PAUSED
