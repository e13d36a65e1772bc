"""Functions as users write them: a fit is that of the function, or says why there is none."""

from __future__ import annotations

import functools
import gc
import math
import time
import traceback
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import special

import miho
from miho.models.expression import Expression
from miho.models.function_model import FunctionModel

t = np.linspace(0, 4, 41)
noise = 0.01 * np.random.default_rng(3).standard_normal(t.size)
BOX = {"a": (0.1, 3.0), "b": (0.1, 3.0)}
FEW = miho.Budget(evaluations=300)


def fitted(function: Any, y: Any, box: Any = BOX, **settings: Any) -> miho.Fit:
    return miho.fit(function, t, y, box, **{"compiled": False, "budget": FEW, **settings})


def _hides_an_exception(t: Any, a: Any, b: Any) -> Any:
    try:
        if a > 2.95:
            return b * t
    except Exception:  # noqa: BLE001 -- as users write it
        pass
    return a * t + b


def _hides_anything(t: Any, a: Any, b: Any) -> Any:
    try:
        gamma = math.gamma(a)
    except:  # noqa: E722 -- as users write it
        gamma = 1.0
    return gamma * t + b


def _asks_for_an_attribute(t: Any, a: Any, b: Any) -> Any:
    try:
        rows = t.shape[0]
    except AttributeError:
        rows = 7
    return a * t + b * rows / 41


def _divides_whole(t: Any, a: Any, b: Any) -> Any:
    try:
        whole = a // 1
    except TypeError:
        whole = 5
    return whole * t + b


def _floor_or_none(a: Any) -> Any:
    try:
        return math.floor(a)
    except Exception:  # noqa: BLE001 -- as users write it
        return 0


def _writes_into_rows(t: Any, a: Any, b: Any) -> Any:
    values = a * t
    values[t > 2] = b
    return values


def _returns_early(t: Any, a: Any, b: Any) -> Any:
    return a * t if b < 0.3 else a * np.exp(-b * t)


def _looks_at_all(t: Any, a: Any, b: Any) -> Any:
    return b * t if np.any(a > 2.9) else a * t + b


FUNCTIONS: dict[str, Callable[..., Any]] = {
    "an except": _hides_an_exception,
    "a bare except": _hides_anything,
    "an attribute": _asks_for_an_attribute,
    "an operator": _divides_whole,
    "a helper with an except": lambda t, a, b: _floor_or_none(a) * t + b,
    "written rows": _writes_into_rows,
    "an early return": _returns_early,
    "any of an array": _looks_at_all,
    "a comparison times": lambda t, a, b: a * t - (t > 1) * b,
    "a negative comparison": lambda t, a, b: a * t + (0 - (t > 1)) * b,
    "squares of comparisons": lambda t, a, b: ((t > 1) ** 2 + (t > 2) ** 2) * a + b * t,
    "a root of a comparison": lambda t, a, b: (t > 1) ** 0.5 * a + b * t / 3,
    "a sum of comparisons": lambda t, a, b: ((t > 1) + (t > 2)) * a + b,
    "scipy": lambda t, a, b: a * special.erf(b * t),
    "a table": lambda t, a, b: a * np.interp(t, [0, 1, 4], [0, b, 1]),
    "pieces": lambda t, a, b: np.piecewise(t, [t < 1, t >= 1], [lambda t: a * t, lambda t: b]),
    "a vectorized one": lambda t, a, b: np.vectorize(lambda x: a * x if x < 2 else b)(t),
    "math": lambda t, a, b: a * np.exp(-t) * math.exp(-b),
    "whole numbers": lambda t, a, b: a * t ** int(b) + np.floor(t),
    "Python's maximum": lambda t, a, b: max(a, b) * t,
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_error_of_a_fit_is_that_of_the_function(name: str) -> None:
    """To rounding, in regions of the box that few trial calls come across as well."""
    function = FUNCTIONS[name]
    y = np.asarray(function(t, 2.99, 0.7)) + noise
    fit = fitted(function, y)
    own = np.sqrt(np.mean((function(t, fit.values["a"], fit.values["b"]) - y) ** 2))
    assert fit.error == pytest.approx(own, rel=1e-9)


@pytest.mark.parametrize("name", ["an except", "a bare except", "an attribute", "an operator"])
def test_what_hides_that_it_is_no_formula_is_called(name: str) -> None:
    model = FunctionModel(FUNCTIONS[name], columns=("t",))
    assert model.formula is None


def test_a_formula_that_proves_false_after_the_search_is_not_believed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A function that turns into another one after its trial calls, as one that reads a file."""
    calls = list[int]()

    def turns(t: Any, a: Any, b: Any) -> Any:
        calls.append(1)
        return a * t + b * (1.0 if len(calls) < 20 else t * t)

    fit = fitted(turns, t + 0.5 * t * t + noise)
    assert "other values for numbers than for arrays" in capsys.readouterr().err
    assert fit.values == pytest.approx({"a": 1.0, "b": 0.5}, abs=0.02)
    assert not isinstance(fit.problem.model, Expression)


def _differs_in_half_of_the_box(t: Any, a: Any, b: Any) -> Any:
    return a * np.exp(-b * t) + (0.3 * np.sin(t) if isinstance(b, float) and b < 1.5 else 0)


def _differs_at_the_optimum(t: Any, a: Any, b: Any) -> Any:
    return a * np.exp(-b * t) + (0.1 if isinstance(b, float) and abs(b - 0.7) < 0.02 else 0)


@pytest.mark.parametrize("function", [_differs_in_half_of_the_box, _differs_at_the_optimum])
def test_a_function_that_differs_for_numbers_spends_its_budget_once(
    function: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    spent = list[float]()

    def counted(*arguments: Any, **settings: Any) -> miho.RunRecord:
        run = miho.minimize(*arguments, **settings)
        spent.append(run.evaluations)
        return run

    monkeypatch.setattr("miho.fitting.search.minimize", counted)
    y = 2 * np.exp(-0.7 * t) + noise
    few = miho.Budget(evaluations=150)
    fit = fitted(function, y, budget=few)
    assert "other values for numbers than for arrays" in capsys.readouterr().err
    assert sum(spent) <= 150
    own = np.sqrt(np.mean((function(t, *fit.values.values()) - y) ** 2))
    assert fit.error == pytest.approx(own, rel=1e-9)


def test_zeros_are_those_of_numpy() -> None:
    """0 / t and 0 * log(t) have no value where t is 0, in a row that no trial call need take."""
    rows = np.linspace(-1, 1, 4001)
    for function in (lambda t, a: a * t + 0 / t, lambda t, a: a * t + 0 * np.log(abs(t))):
        formula = FunctionModel(function, columns=("t",)).formula
        assert formula is not None
        values = formula.predict(np.array([[2.0]]), rows)[0]
        assert np.flatnonzero(np.isnan(values)).tolist() == [2000]


def _raises(t: Any, a: Any, b: Any) -> Any:
    if b > 0.9:
        raise RuntimeError("no convergence")
    return a * np.exp(-b * t)


def test_what_raises_in_a_part_of_the_box_has_no_value_there(
    capsys: pytest.CaptureFixture[str],
) -> None:
    fit = fitted(_raises, 2 * np.exp(-0.7 * t), {"a": (0, 6), "b": (0, 30)}, budget=None)
    assert fit.values == pytest.approx({"a": 2.0, "b": 0.7}, rel=1e-6)
    said = capsys.readouterr().err
    assert "evaluations without a value: " in said
    assert "_raises raises RuntimeError: no convergence; first at a = " in said
    # So it is beside the edge, where one of two differences has no value.
    at_edge = fitted(_raises, 2 * np.exp(-0.9 * t), {"a": (0, 6), "b": (0, 30)}, budget=None)
    assert at_edge.values == pytest.approx({"a": 2.0, "b": 0.9}, rel=1e-5)


def test_what_raises_everywhere_is_refused_with_its_traceback() -> None:
    def never(t: Any, a: Any, b: Any) -> Any:
        raise RuntimeError("never")

    with pytest.raises(ValueError, match="never raises RuntimeError: never") as caught:
        fitted(never, t)
    assert "in never" in "".join(traceback.format_exception(caught.value))


def _line(t: Any, a: Any, b: Any, c: Any = 0.5) -> Any:
    return a * t + b + c * t**2


HELD: dict[str, tuple[Any, dict[str, Any], dict[str, float]]] = {
    "a default": (_line, {}, {"c": 0.5}),
    "a default that is fixed": (_line, {"fixed": {"c": 0.0}}, {"c": 0.0}),
    "a bound argument": (functools.partial(_line, c=0.25), {}, {"c": 0.25}),
    "one before others": (functools.partial(_line, b=1.0), {"box": {"a": (-9, 9)}}, {"b": 1.0}),
    "two": (functools.partial(functools.partial(_line, c=1), b=2), {"box": {"a": (-9, 9)}},
            {"b": 2.0, "c": 1.0}),
    "a start": (_line, {"box": None, "start": {"a": 1, "b": 1}}, {"c": 0.5}),
}  # fmt: skip


@pytest.mark.parametrize("name", HELD)
def test_a_default_or_bound_argument_is_fixed_without_bounds(name: str) -> None:
    function, settings, held = HELD[name]
    y = 1.5 * t + 0.8 + 0.3 * t**2 + noise
    fit = fitted(function, y, **{"box": {"a": (-9, 9), "b": (-9, 9)}, **settings})
    assert {key: fit.values[key] for key in held} == held
    assert (fit.parameters.loc[list(held), "status"] == "fixed").all()
    free = fitted(function, y, dict.fromkeys("abc", (-9, 9)))
    assert free.values == pytest.approx({"a": 1.5, "b": 0.8, "c": 0.3}, abs=0.05)


def test_a_space_may_leave_out_what_has_a_default() -> None:
    """As on the command line, where a configuration names the parameters."""

    def line(x: Any, *, a: Any, b: Any, c: Any = 1.0, kind: str = "plain") -> Any:
        return a * x + b + c if kind == "plain" else x

    dataset = miho.Dataset("line", {"x": t, "y": 2 * t + 1.5}, {"x": "s", "y": "V"}, "y")
    box = (miho.Parameter("a", "V/s", 0, 5), miho.Parameter("b", "V", 0, 5))
    problem = miho.CurveFit(line, dataset, miho.Space(box), compiled=False)
    assert problem.loss(np.array([[2.0, 0.5]])) == pytest.approx(0)


def test_two_calls_that_differ_are_said() -> None:
    random = np.random.default_rng(0)

    def noisy(t: Any, a: Any, b: Any) -> Any:
        return a * np.exp(-b * t) + 0.01 * random.standard_normal(t.size)

    with pytest.warns(UserWarning, match="two calls with the same parameters give the errors"):
        fitted(noisy, 2 * np.exp(-0.7 * t))


MISSING = "a number is missing .NaN. in 2 of 41 rows, first in row 4; .* missing='drop'"
y = 2 * t + 0.5
gaps = np.where((t == t[3]) | (t == t[7]), np.nan, y)


@pytest.mark.parametrize(
    "given",
    [gaps, np.ma.masked_invalid(gaps), pd.Series(gaps).astype("Float64"),
     [None if math.isnan(value) else value for value in gaps]],
)  # fmt: skip
def test_rows_without_a_number_are_refused_or_left_out(
    given: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    def line(t: Any, a: Any, b: Any) -> Any:
        return a * t + b

    with pytest.raises(ValueError, match=MISSING):
        fitted(line, given)
    fit = fitted(line, given, missing="drop")
    assert len(fit.problem.dataset) == 39
    assert "2 of 41 rows are dropped: a number is missing in y" in capsys.readouterr().err
    with pytest.raises(ValueError, match="missing is 'omit'; expected one of raise, drop"):
        fitted(line, given, missing="omit")


def test_complex_numbers_and_changed_columns_have_a_remedy() -> None:
    def lag(t: Any, a: Any, b: Any) -> Any:
        return a / (1 + 1j * b * t)

    def shifts(t: Any, a: Any, b: Any) -> Any:
        t -= 1
        return a * t + b

    measured = lag(t, 2.0, 0.7)
    with pytest.raises(ValueError, match=r"y is complex128; .*miho.fit_joint\(.*y\.imag\)"):
        fitted(lag, measured)
    with pytest.raises(ValueError, match=r"got complex128; .*miho\.fit_joint"):
        fitted(lag, t)
    with pytest.raises(ValueError, match=r"read-only; columns .* x = x\.copy\(\)"):
        fitted(shifts, t)
    parts = {
        "real": (lambda t, a, b: lag(t, a, b).real, t, measured.real),
        "imag": (lambda t, a, b: lag(t, a, b).imag, t, measured.imag),
    }
    joint = miho.fit_joint(parts, BOX, budget=FEW, compiled=False)
    assert joint.values == pytest.approx({"a": 2.0, "b": 0.7}, rel=1e-6)


def clipped(t, a, b):
    """It takes arrays alone: numbers have no method `clip`."""
    return a.clip(0, 4) * np.exp(-b * t)


def hill(x, top, k, n):
    """With numbers k**n overflows in a corner of the box, with arrays it is infinite."""
    return top * x**n / (k**n + x**n)


def test_a_call_with_numbers_that_raises_is_no_other_value(
    capsys: pytest.CaptureFixture[str],
) -> None:
    t = np.linspace(0, 2, 30)
    fit = miho.fit(clipped, t, 2 * np.exp(-1.5 * t), {"a": (0, 5), "b": (0, 10)}, compiled=False)
    assert fit.values == pytest.approx({"a": 2.0, "b": 1.5}, rel=1e-6)
    box = {"top": (0, 5), "k": (0.01, 3000), "n": (0.1, 100)}
    x = np.linspace(0.1, 10, 40)
    fit = miho.fit(hill, x, hill(x, 2.0, 3.0, 2.5), box, compiled=False)
    assert fit.values == pytest.approx({"top": 2.0, "k": 3.0, "n": 2.5}, rel=1e-6)
    assert "other values" not in capsys.readouterr().err


def test_a_slow_formula_is_compared_at_the_optimum_alone() -> None:
    calls = []

    def slow(t, a, b):
        calls.append((a, b))
        if isinstance(a, float):
            time.sleep(0.03)  # above the 10 ms from which an evaluation counts as expensive
        return a * np.exp(-b * t)

    t = np.linspace(0, 2, 30)
    miho.fit(slow, t, 2 * np.exp(-1.5 * t), {"a": (0, 5), "b": (0, 10)}, compiled=False)
    assert len(calls) <= 10


def test_a_partial_may_bind_the_first_argument() -> None:
    def scaled(k, t, a, b):
        return k * a * np.exp(-b * t)

    t = np.linspace(0, 2, 30)
    bound = functools.partial(scaled, k=1.0)
    fit = miho.fit(bound, t, 2 * np.exp(-1.5 * t), {"a": (0, 5), "b": (0, 10)}, compiled=False)
    assert fit.values == pytest.approx({"k": 1.0, "a": 2.0, "b": 1.5}, rel=1e-6)


def test_a_missing_number_of_pandas_is_left_out() -> None:
    y = pd.Series([1.0, pd.NA, 3.0, 4.0, 5.2], dtype=object)
    fit = miho.fit(lambda t, a: a * t, np.arange(1.0, 6.0), y, {"a": (0, 9)}, missing="drop",
                   compiled=False)  # fmt: skip
    assert len(fit.problem.dataset) == 4


def test_a_default_of_one_part_fixes_no_parameter_of_another() -> None:
    def line(t, a, b=0.5):
        return a + b * t

    t = np.linspace(0, 2, 20)
    parts = {"f": (lambda t, a, b: a * np.exp(-b * t), t, np.exp(-t)), "g": (line, t, t)}
    with pytest.raises(ValueError, match="b has no bounds"):
        miho.fit_joint(parts, {"a": (0, 5)}, compiled=False)


def test_a_budget_without_a_value_is_said() -> None:
    """Any budget pays for one look at a few rows; a method that makes none is refused."""

    class Idle(miho.Optimizer):
        """A method whose budget ends before its first evaluation."""

        def run(self, oracle: miho.Oracle, rng: np.random.Generator) -> None:
            pass

    t = np.linspace(0, 2, 30)
    settings: dict[str, Any] = {"budget": miho.Budget(seconds=1e-9), "compiled": False}
    decay = lambda t, a, b: a * np.exp(-b * t)  # noqa: E731
    fit = miho.fit(decay, t, t, {"a": (0, 5), "b": (0, 10)}, **settings)
    assert "no independent search finished within the budget" in fit.optimum
    with pytest.raises(ValueError, match="the budget ended before the first value"):
        miho.fit(decay, t, t, {"a": (0, 5), "b": (0, 10)}, method=Idle(), **settings)


def test_a_refused_trace_keeps_nothing_of_its_caller() -> None:
    class Table:
        """Anything that the caller holds."""

    def fitted() -> weakref.ref[Table]:
        table = Table()
        t = np.linspace(0, 2, 30)
        miho.fit(lambda t, a, b: a + (t > 1) ** 2 * b, t, t, {"a": (0, 5), "b": (0, 10)},
                 compiled=False)  # fmt: skip
        return weakref.ref(table)

    left = fitted()
    gc.collect()
    assert left() is None
