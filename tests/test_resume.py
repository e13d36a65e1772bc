"""Runs of the command line that are interrupted go on from their journal."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from experiments.app.build import ConfigError, build
from experiments.app.compose import composed
from experiments.app.plan import request_of
from experiments.app.runs import run
from experiments.app.schema import SweepConfig
from miho.parallel import usage, worth
from miho.study.files import JOURNAL

MODEL = """
import os
import signal
import numpy as np

FOLDER = os.path.dirname(__file__)


def decay(t: "s", *, a: "V", b: "1/s") -> "V":
    a, b = float(a), float(b)  # which no formula can be traced through
    with open(os.path.join(FOLDER, "calls"), "ab") as calls:
        calls.write(b".")
        stop = calls.tell() == 20 and os.path.exists(os.path.join(FOLDER, "stop"))
    if stop:
        os.kill(os.getpid(), signal.SIGINT)
    gain = 1.0
    if os.path.exists(os.path.join(FOLDER, "gain")):
        with open(os.path.join(FOLDER, "gain")) as file:
            gain = float(file.read())
    return gain * a * np.exp(-b * t)
"""


class Runs:
    """One run of a model that counts its calls, again and again."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir()
        (folder / "decay.py").write_text(MODEL)
        rows = "\n".join(f"{0.1 * k:.1f},{2 * 0.8**k:.4f}" for k in range(20))
        (folder / "data.csv").write_text(f"t,U\n{rows}\n")

    def configured(self, *overrides: str) -> Any:
        return composed([
            "model=function", f"model.path={self.folder}/decay.py", "model.batched=false",
            "model.function=decay", "dataset=csv", f"dataset.path={self.folder}/data.csv",
            "dataset.columns=[t,U]", "dataset.units=[s,V]", "dataset.output=U",
            "space={a: {unit: V, low: 0, high: 5}, b: {unit: 1/s, low: 0.1, high: 5}}",
            "optimizer=miho", "budget.evaluations=50", f"root={self.folder}/runs", *overrides,
        ])  # fmt: skip

    def __call__(self, *overrides: str) -> str:
        """The line of the run."""
        cfg = self.configured(*overrides)
        outcome = run([request_of(build(cfg), cfg)], SweepConfig(), here=True)
        outcome.raise_if_stopped()
        return outcome.states[0].line

    @property
    def calls(self) -> int:
        return (self.folder / "calls").stat().st_size

    @property
    def journals(self) -> list[Path]:
        return list(self.folder.glob(f"runs/*/*/*/{JOURNAL}"))

    @property
    def result(self) -> tuple[Any, ...]:
        (path,) = self.folder.glob("runs/*/*/*/result.json")
        result = json.loads(path.read_text())
        return tuple(result[name] for name in ("loss", "theta", "evaluations", "rejected"))


@pytest.fixture(autouse=True)
def expensive(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every evaluation counts as expensive, however long it takes."""
    monkeypatch.setattr(worth, "EXPENSIVE", 0.0)
    monkeypatch.setattr(usage, "LEAST", 0.0)
    monkeypatch.setattr(usage, "ALONE", 0.0)


@pytest.fixture
def plain(tmp_path: Path) -> Runs:
    """A run that was not interrupted."""
    runs = Runs(tmp_path / "plain")
    runs()
    assert not runs.journals
    return runs


def interrupted(folder: Path) -> Runs:
    """A run that was interrupted at its 20th evaluation, the trial included."""
    runs = Runs(folder)
    (folder / "stop").touch()
    with pytest.raises(KeyboardInterrupt):
        runs()
    (folder / "stop").unlink()
    assert runs.calls == 20
    return runs


def test_an_interrupted_run_goes_on(
    plain: Runs, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = interrupted(tmp_path / "again")
    runs()
    assert "continues from" in capsys.readouterr().err
    assert runs.calls == plain.calls + 3  # which are compared with the journal
    assert runs.result == plain.result
    assert not runs.journals


def test_a_journal_that_cannot_be_used_is_set_aside(
    plain: Runs, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = interrupted(tmp_path / "again")
    (journal,) = runs.journals
    journal.write_bytes(b"nothing\nof ours\n")
    runs()
    assert "set aside as journal.damaged" in capsys.readouterr().err
    assert runs.result == plain.result
    assert journal.with_name("journal.damaged").read_bytes() == b"nothing\nof ours\n"


def test_a_journal_of_a_model_that_has_changed_is_set_aside(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changed, runs = Runs(tmp_path / "changed"), interrupted(tmp_path / "again")
    for folder in (changed.folder, runs.folder):
        (folder / "gain").write_text("2")
    changed()
    capsys.readouterr()
    runs()
    said = capsys.readouterr().err
    assert "its model has changed: at (" in said
    assert "set aside as journal.damaged" in said
    assert runs.result == changed.result


def test_a_journal_whose_model_fails_for_now_stays(tmp_path: Path) -> None:
    """The run ends with a line."""
    runs = interrupted(tmp_path / "again")
    (journal,) = runs.journals
    content = journal.read_bytes()
    (runs.folder / "gain").mkdir()  # which cannot be opened
    line = runs()
    assert "seed 0: failed: journal" in line
    assert "cannot be checked, because the model now fails: " in line
    assert journal.read_bytes() == content
    assert not journal.with_name("journal.damaged").exists()


def test_workers_are_no_part_of_a_run(plain: Runs, capsys: pytest.CaptureFixture[str]) -> None:
    calls = plain.calls
    plain("workers=2", "evaluation_limit=100")
    assert plain.calls == calls
    assert len(list(plain.folder.glob("runs/*/*/*/result.json"))) == 1


def test_how_a_function_was_called_is_stored(plain: Runs) -> None:
    (path,) = plain.folder.glob("runs/*/*/*/result.json")
    assert json.loads(path.read_text())["facts"]["called_as"] == [[False, None, True]]


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("workers=0", "workers is 0; expected a number of processes"),
        ("workers=1.5", "workers is 1.5; expected"),
        ("workers=many", "workers is 'many'; expected"),
        ("evaluation_limit=-1", "evaluation_limit"),
    ],
)
def test_nonsense_is_refused_in_a_line(tmp_path: Path, override: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as error:
        build(Runs(tmp_path / "runs").configured(override))
    assert "\n" not in str(error.value)
