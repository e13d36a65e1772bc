"""A user's own function: what it may look like, what is said of one that cannot be used."""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import cloudpickle
import numpy as np
import pytest

import miho
from experiments.app.build import ConfigError, build
from experiments.app.compose import composed
from miho import Budget, CurveFit, Dataset, Parameter, Space, minimize
from miho.models import FunctionModel, Model, load_function
from miho.models.expression import Expression
from miho.models.plain_arithmetic import is_arithmetic
from miho.optim import RandomSearch
from miho.testing import check_model

DECAY = """
import numpy as np

def decay(t: "s", *, a: "V", b: "1/s") -> "V":
    return a * np.exp(-b * t)
"""
THETAS = np.array([[2.0, 1.5], [1.0, 0.3], [0.5, 4.0]])
t = np.linspace(0, 2, 50)


@pytest.fixture
def load(tmp_path: Path) -> Callable[..., Model]:
    """Write a file and load the model in it."""

    def write_and_load(text: str, **settings: Any) -> Model:
        (tmp_path / "mine.py").write_text(text)
        return load_function(str(tmp_path / "mine.py"), **settings)

    return write_and_load


@pytest.mark.parametrize("batched", [True, False, None])
@pytest.mark.parametrize("future", ["", "from __future__ import annotations\n"])
def test_a_function_is_a_model(load: Callable[..., Model], future: str, batched: bool) -> None:
    model = load(future + DECAY, batched=batched, linear=["a"])
    assert (dict(model.inputs), dict(model.parameters)) == ({"t": "s"}, {"a": "V", "b": "1/s"})
    assert (model.output, model.name, model.linear) == ("V", "decay", ("a",))
    assert model.source is not None
    assert model.source.name == "mine.py"
    expected = [2 * np.exp(-1.5 * t), np.exp(-0.3 * t), 0.5 * np.exp(-4 * t)]
    assert np.array_equal(model.predict(THETAS, t), expected)
    check_model(model, THETAS, t)


def test_a_worker_without_the_file_has_its_classes(
    load: Callable[..., Model], tmp_path: Path
) -> None:
    text = """
class Gain:
    def __init__(self, size):
        self.size = size

GAIN = Gain(3.0)

def line(t: "s", *, a: "V/s") -> "V":
    return GAIN.size * a * t
"""
    model = load(text, function="line")
    stored = tmp_path / "model.pickle"
    stored.write_bytes(cloudpickle.dumps(model))
    (tmp_path / "mine.py").unlink()
    program = (
        "import pickle, sys, numpy as np; model = pickle.load(open(sys.argv[1], 'rb'));"
        "print(model.predict(np.ones((1, 1)), np.ones(1))[0, 0])"
    )
    process = subprocess.run(
        [sys.executable, "-c", program, str(stored)], capture_output=True, text=True
    )
    assert process.stdout == "3.0\n", process.stderr


def test_the_derivatives_are_those_of_the_formula(load: Callable[..., Model]) -> None:
    """Central differences leave about 1e-10 of the size of the derivative."""
    decay = np.exp(-1.5 * t)
    exact = np.stack([decay, -2 * t * decay], axis=1)
    derivatives = load(DECAY).jacobian(THETAS[0], t)
    np.testing.assert_allclose(derivatives, exact, rtol=0, atol=1e-9)


def test_a_function_that_branches_runs_row_by_row(load: Callable[..., Model]) -> None:
    branching = DECAY.replace("    return", "    if b > 1:\n        return 0\n    return")
    model = load(branching, batched=False)
    assert np.array_equal(model.predict(THETAS, t)[1], np.exp(-0.3 * t))
    assert not model.predict(THETAS, t)[[0, 2]].any()
    with pytest.raises(ValueError, match=r"mine.py:5: decay raises ValueError: The truth value.*"
                       r"; calls with one row.*work; set batched to false"):  # fmt: skip
        load(branching, batched=True).predict(THETAS, t)


def test_nothing_of_the_callers_is_edited_or_handed_out(load: Callable[..., Model]) -> None:
    head = (
        '\nimport numpy as np\nkept = np.zeros((1, 50))\n\ndef f(t: "s", *, a: "V") -> "V":\n    '
    )
    model = load(f"{head}return kept")
    values = model.predict(np.ones((1, 1)), t)
    values += 1
    assert not model.predict(np.ones((1, 1)), t).any()
    thetas = np.ones((2, 1))
    scribbles = load(f"{head}a *= 2\n    return t + a")
    assert np.array_equal(scribbles.predict(thetas, t), [t + 2, t + 2])
    assert np.array_equal(thetas, np.ones((2, 1)))
    with pytest.raises(ValueError, match="f raises ValueError: output array is read-only"):
        load(f"{head}t += a\n    return t").predict(thetas, t)


@pytest.mark.parametrize("value", ["math.exp(a * t)", "a if t < 1 else t", "max(t, a)"])
def test_a_function_of_one_row_gets_a_hint(value: str) -> None:
    with pytest.raises(ValueError, match=r"a column is an array: use numpy\.exp for math\.exp"):
        miho.fit(eval(f"lambda t, a: {value}", {"math": math}), t, t, {"a": (0, 1)})


BAD = {
    "any arguments": (DECAY.replace("*,", "*rest,"), r"got \*rest; name each argument, as in"),
    "no parameters": (DECAY.replace("*, ", ""), "one parameter, got 3 and 0"),
    "no columns": (DECAY.replace('t: "s", ', ""), "one parameter, got 0 and 2"),
    "a syntax error": (DECAY.replace("(-b * t)", "(-b * t"), "mine.py:5: '.' was never closed"),
    "a null byte": (DECAY + "\0", "mine.py.*null bytes"),
    "a failing import": ("\nimport nothere\n", "mine.py:2: raises ModuleNotFoundError"),
    "an exit": ("raise SystemExit(5)", "mine.py:1: raises SystemExit: 5"),
    "no function": ("import numpy as np\nfrom os.path import join", "no public function"),
    "two functions": (DECAY + DECAY.replace("decay", "other"), "functions decay, other; name one"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_a_model_is_refused(load: Callable[..., Model], case: str) -> None:
    text, message = BAD[case]
    with pytest.raises(ValueError, match=message) as caught:
        load(text)
    assert "mine.py" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_settings_that_do_not_fit_are_refused(load: Callable[..., Model], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no function 'grow'; it has decay"):
        load(DECAY, function="grow")
    with pytest.raises(ValueError, match=r"linear is \('z',\); expected.*among a, b"):
        load(DECAY, linear=["z"])
    assert load(DECAY + DECAY.replace("decay", "_own"), function="_own").name == "_own"
    with pytest.raises(ValueError, match="batched is 'no'; expected True or False, or None"):
        load(DECAY, batched="no")
    with pytest.raises(FileNotFoundError):
        load_function(str(tmp_path / "none.py"))
    with pytest.raises(ValueError, match="not a function with a signature; wrap it"):
        FunctionModel(5)  # type: ignore[arg-type]


def test_results_of_another_shape_or_kind_are_refused(load: Callable[..., Model]) -> None:
    for result, message in {
        "t": r"expected shape \(3, 50\).*got \(50,\).*broadcast",
        "np.sum(a * t)": r"got \(\)",
        "1j * a * t": "expected real numbers, got complex128",
        "None": "got NoneType",
    }.items():
        with pytest.raises(ValueError, match=message):
            load(DECAY.replace("a * np.exp(-b * t)", result), batched=True).predict(THETAS, t)
    for result, message in {
        "t[:7]": r"expected shape \(50,\) for columns \(50,\), got \(7,\)",
        "1j * a * t": "expected real numbers, got complex128",
    }.items():
        with pytest.raises(ValueError, match=message):
            load(DECAY.replace("a * np.exp(-b * t)", result)).predict(THETAS, t)
    constant = load(DECAY.replace("a * np.exp(-b * t)", "a"))
    assert np.array_equal(constant.predict(THETAS, t), THETAS[:, [0]] + 0 * t)
    with pytest.raises(ValueError, match=r"for columns \(50,\), got \(2,\)"):
        load(DECAY.replace("a *", "t[:2] +").replace("* t", "+ t[:2]"), batched=False).predict(
            THETAS, t
        )


def problem(model: Model) -> CurveFit:
    space = Space((Parameter("a", "V", 0, 5), Parameter("b", "1/s", 0.01, 10, scale="log")))
    data = Dataset("d", {"t": t, "y": 2 * np.exp(-1.5 * t)}, {"t": "s", "y": "V"}, "y")
    return CurveFit(model, data, space)


def test_what_it_raises_in_a_run_is_counted_with_its_line(load: Callable[..., Model]) -> None:
    raising = DECAY.replace("    return", "    if np.any(b > 2):\n        1 / 0\n    return")
    fit = problem(load(raising))
    record = minimize(RandomSearch(batch=50), fit, Budget(evaluations=200), seed=1)
    assert record.theta is not None
    assert record.theta[1] <= 2
    ((reason, count),) = record.rejected.items()
    reason, _, first = reason.partition("; first at ")
    assert reason.endswith("mine.py:6: decay raises ZeroDivisionError: division by zero")
    assert re.fullmatch(r"a = [\d.]+, b = [\d.]+", first)
    assert 0 < count < 200


def test_infinities_are_values_without_warnings(load: Callable[..., Model]) -> None:
    model = load(DECAY.replace("-b", "1e9 * b"))
    assert np.isinf(model.predict(THETAS, t)[:, 1:]).all()


def configuration(tmp_path: Path, text: str) -> list[str]:
    (tmp_path / "mine.py").write_text(text)
    rows = "\n".join(f"{x},{2 * np.exp(-1.5 * x)}" for x in t)
    (tmp_path / "mine.csv").write_text(f"t,y\n{rows}\n")
    return [
        "model=function", f"model.path={tmp_path / 'mine.py'}",
        "dataset=csv", f"dataset.path={tmp_path / 'mine.csv'}",
        "dataset.columns=[t, y]", "dataset.units=[s, V]", "dataset.output=y",
        "~space", "+space={a: {unit: V, low: 0, high: 5}, b: {unit: 1/s, low: 0.1, high: 9}}",
    ]  # fmt: skip


def test_an_edit_is_another_run(tmp_path: Path) -> None:
    first = build(composed(configuration(tmp_path, DECAY)))
    assert build(composed(configuration(tmp_path, DECAY))).identity == first.identity
    before = (tmp_path / "mine.py").stat().st_mtime_ns
    edited = configuration(tmp_path, DECAY.replace("-b", "+b"))  # of the same length
    os.utime(tmp_path / "mine.py", ns=(before, before))
    second = build(composed(edited))
    assert second.identity.code != first.identity.code
    # The data are NumPy's exponentials; the machine's may differ by an ulp of 2 (4e-16).
    assert second.problem.loss(THETAS)[0] > 1e-3
    assert first.problem.loss(THETAS)[0] <= 1e-31
    assert first.problem.name == "decay-mine"
    assert not list(tmp_path.rglob("__pycache__"))


def test_a_configuration_that_cannot_be_used_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"model: .*mine.py:5: '\(' was never closed"):
        build(composed(configuration(tmp_path, DECAY.replace("t)", "t"))))
    with pytest.raises(ConfigError, match=r"mine.py:5: decay raises NameError: name 'c' is not"):
        build(composed(configuration(tmp_path, DECAY.replace("-b", "-c"))))
    with pytest.raises(ConfigError, match=r"model.path: is missing"):
        build(composed(["model=function"]))


@pytest.mark.parametrize("theta", [0.0, 1e-20, 1e-12, -1e-7, 3.0])
def test_derivatives_near_zero_are_not_lost(theta: float) -> None:
    """y = 1000 + a t: the derivative is t, known to the rounding of 1000 over the step."""
    t = np.linspace(0.5, 1, 5)
    model = FunctionModel(offset)
    derivatives = model.jacobian(np.array([theta]), t)[:, 0]
    np.testing.assert_allclose(derivatives, t, rtol=1e-5)


def offset(t: "s", *, a: "V") -> "V":  # noqa: F821, UP037
    return 1000 + a * t


ARITHMETIC = {
    "a formula": DECAY,
    "steps and choices": """
import math
import numpy as np
from numpy import exp
RATE = 1.0

def decay(t: "s", *, a: "V", b: "1/s") -> "V":
    'Text.'
    rate, late = b * RATE, t > 1
    if RATE < 0.5:
        rate = -rate
    value = a * exp(-rate * t)
    value = value * math.sqrt(1.0)
    return np.where(late, value, _early(np.clip(t, 0, 9), a, b)) if RATE > 0 else value

def _early(t, a, b):
    return a * math.e ** (-b * t) * abs(-1)
""",
}


@pytest.mark.parametrize("name", ARITHMETIC)
def test_arithmetic_in_a_file_has_exact_derivatives(load: Callable[..., Model], name: str) -> None:
    """Against the closed form, to rounding."""
    model = load(ARITHMETIC[name])
    problem = CurveFit(model, *_decay())
    assert isinstance(problem.model, Expression)
    assert problem.model.source == model.source
    decay = np.exp(-1.5 * t)
    exact = np.stack([decay, -2 * t * decay], axis=1)
    np.testing.assert_allclose(problem.model.jacobian(THETAS[0], t), exact, rtol=1e-14, atol=1e-14)


OTHER = {
    "counts its calls": "global calls; calls += 1",
    "counts elsewhere": "count.append(1)",
    "sets an attribute": "decay.calls = 1",
    "sets an item": "count[0] = 1",
    "reads a file": "open(__file__).close()",
    "random": "a = a * np.random.rand()",
    "imports": "import os",
    "loops": "while calls > 1: b = 1",
    "calls what it is given": "b.sort()",
    "asks a table": "a = a * table.max()",
    "takes a table": "a = a * table",
    "calls what does more": "helper()",
    "calls itself": "decay(t, a=a, b=b)",
    "replaced": "np.tan(1.0)",
    "made to look like NumPy's": "fake(1.0)",
    "a local of a module's name": "np = count; np.append(1)",
    "a function inside": "f = lambda: 1",
    "sets a number of a module": "np.pi = 3",
    "adds to a number of a module": "np.e += 1",
    "a number that counts": "a = counting * a",
}


DOING = """
import numpy as np
calls, count, table = 0, [0], np.arange(3.0)
fake = np.frompyfunc(lambda x: count.append(1) or x, 1, 1)
class Counting(float):
    def __mul__(self, other):
        count.append(1)
        return other
counting = Counting(1.0)
{first}
def helper():
    count.append(1)
def decay(t: "s", *, a: "V", b: "1/s") -> "V":
    {deed}
    return a * np.exp(-b * t)
"""


def test_what_a_file_does_besides_is_not_done_to_look_at_it(
    load: Callable[..., Model], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(np, "tan", np.tan)  # is put back
    plain = load(DOING.format(first="", deed="b = 1 * b"), function="decay")
    assert is_arithmetic(cast(FunctionModel, plain).function)
    for name, deed in OTHER.items():
        first = "np.tan = lambda x: count.append(1)" if name == "replaced" else ""
        model = load(DOING.format(first=first, deed=deed), function="decay")
        assert not is_arithmetic(cast(FunctionModel, model).function), name
    assert isinstance(CurveFit(model, *_decay()).model, FunctionModel)


def _decay() -> tuple[Dataset, Space]:
    data = Dataset("d", {"t": t, "y": 2 * np.exp(-1.5 * t)}, {"t": "s", "y": "V"}, "y")
    return data, Space((Parameter("a", "V", 0, 5), Parameter("b", "1/s", 0.01, 10)))
