"""A program as a model: what it reads and writes, its derivatives, and all ways to fail."""

import pickle
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import miho
from experiments.app.safety import TargetError, allowed, find_target
from miho.models import Model
from miho.models.command import CommandModel

PROGRAM = """\
import csv, json, math, pathlib, time
p = json.loads(pathlib.Path("parameters.json").read_text())
if p["b"] == -70: open("output.txt", "w").write("x")
elif p["b"] < 0: raise SystemExit("b is negative")
if p["b"] > 90: time.sleep(60)
rows = list(csv.DictReader(open("inputs.csv")))
values = [p["a"] * math.exp(-p["b"] * float(row["t"])) for row in rows]
if p["b"] > 80: values = values[1:]
if abs(p["b"]) != 70: open("output.txt", "w").write("\\n".join(map(repr, values)))
"""
T = np.linspace(0.0, 2.0, 21)


@pytest.fixture
def model(tmp_path: Path) -> CommandModel:
    (tmp_path / "decay.py").write_text(PROGRAM)
    command = [sys.executable, "-S", "-E", str(tmp_path / "decay.py")]
    return CommandModel(command, {"t": "s"}, {"a": "V", "b": "1/s"}, "V", seconds=20.0)


def test_values_and_derivatives_of_a_program(model: CommandModel) -> None:
    """Central differences of exp(-b t) have a relative error of (0.001 b t)^2 / 6."""
    a, b = 2.0, 1.5
    exact = np.exp(-b * T)
    values = model.predict(np.array([[a, b]]), T)[0]
    np.testing.assert_allclose(values, a * exact, rtol=1e-14)
    slopes = model.jacobian(np.array([a, b]), T)
    np.testing.assert_allclose(slopes, np.column_stack([exact, -a * T * exact]), rtol=1e-5)


def test_a_program_is_identified(model: CommandModel) -> None:
    data = miho.Dataset("d", {"t": T, "y": 2 * np.exp(-1.5 * T)}, {"t": "s", "y": "V"}, "y")
    space = miho.Space((miho.Parameter("a", "V", 1, 3), miho.Parameter("b", "1/s", 1, 2)))
    problem = miho.CurveFit(model, data, space)
    record = miho.minimize(miho.MIHOGN(), problem, miho.Budget(evaluations=30), seed=0)
    np.testing.assert_allclose(record.theta, [2.0, 1.5], rtol=1e-4)


def test_a_call_that_fails_has_no_value(model: CommandModel) -> None:
    """It exits with an error, writes too few numbers, or nothing; the others are as they were."""
    values = model.predict(np.array([[1.0, -1.0], [1.0, 85.0], [1.0, 70.0], [1.0, 0.0]]), T)
    assert np.isnan(values[:3]).all()
    assert (values[3] == 1).all()


@pytest.mark.parametrize(
    ("b", "reason"),
    [
        (-1.0, r"ended with exit code 1: b is negative$"),
        (85.0, r"wrote 20 numbers to output.txt; expected 21, one per row"),
        (70.0, r"wrote no output.txt"),
        (-70.0, r"wrote more than numbers: could not convert string to float: 'x'"),
    ],
)
def test_the_reason_of_a_failed_call_is_an_error(
    model: CommandModel, b: float, reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        model.predict(np.array([[1.0, b]]), T)


def test_a_failure_after_a_success_has_no_value(model: CommandModel) -> None:
    """So that one sporadic failure in a report does not end it; also in a copy."""
    model.predict(np.array([[1.0, 1.0]]), T)
    for used in (model, pickle.loads(pickle.dumps(model))):
        assert np.isnan(used.predict(np.array([[1.0, -1.0]]), T)).all()


def test_a_fit_of_a_program_that_always_fails_gives_the_reason(
    model: CommandModel, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also while it searches, which it does for a program whose calls take long."""
    monkeypatch.setattr("miho.fitting.search.QUIET", 0.0)
    monkeypatch.setattr("miho.fitting.progress.FIRST", 0.0)
    with pytest.raises(ValueError, match="exit code 1: b is negative"):
        miho.fit(model, T, T, {"a": (1, 2), "b": (-2, -1)}, budget=miho.Budget(evaluations=3))
    assert "no value yet (ValueError: " in capsys.readouterr().err


def test_a_call_that_takes_too_long_is_killed(model: CommandModel) -> None:
    started = time.monotonic()
    quick = CommandModel(model.command, model.inputs, model.parameters, "V", seconds=1.0)
    with pytest.raises(ValueError, match="took longer than 1 s"):
        quick.predict(np.array([[1.0, 95.0]]), T)
    assert time.monotonic() - started < 30


def test_what_cannot_be_run_is_named(model: CommandModel) -> None:
    missing = CommandModel(["/no/such/program"], model.inputs, model.parameters, "V")
    with pytest.raises(ValueError, match="command: cannot run '/no/such/program'"):
        missing.predict(np.array([[1.0, 1.0]]), T)
    with pytest.raises(ValueError, match="command is 'rm -r x'; expected a list of the program"):
        CommandModel("rm -r x", model.inputs, model.parameters, "V")
    with pytest.raises(ValueError, match=r"seconds is 0; expected a positive number"):
        CommandModel(["x"], model.inputs, model.parameters, "V", seconds=0)


def test_no_configuration_can_name_a_program() -> None:
    assert "miho.models.CommandModel" not in allowed(Model)
    with pytest.raises(TargetError, match="is not a class or function that gives a Model"):
        find_target("miho.models.command.CommandModel", Model)
