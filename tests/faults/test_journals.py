"""R33 to R35: journals of models that have changed, that write files, and that are no files."""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import socket
import threading
import time
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import miho
from miho.models import FunctionModel
from miho.parallel import JournalError, usage, worth
from tests.faults.commands import forked
from tests.faults.conftest import Figures
from tests.parallel.changed_models import LINE, RANDOM, WAYS, search

SECONDS, KEPT, PATIENCE = 0.012, 10, 60.0
t, y = LINE["t"], LINE["y"]


@pytest.mark.slow
@pytest.mark.fault(
    row="R33",
    fault=f"a number of a model changes behind its journal, in {len(WAYS)} ways",
    promise="refused, or said of random values; the same number goes on",
)
def test_changed_models(tmp_path: Path, measured: Figures) -> None:
    """Each way with the number 1, again with 1, and then with 2."""
    worth.EXPENSIVE = usage.LEAST = 0.0  # type: ignore[misc]  # in the process of this row
    counts: Counter[str] = Counter()
    wrong = []
    for name, make in WAYS.items():
        folder = tmp_path / name
        folder.mkdir()
        search(make(1.0, folder), folder / "journal")
        search(make(1.0, folder), folder / "journal")
        err = io.StringIO()
        try:
            with contextlib.redirect_stderr(err):
                search(make(2.0, folder), folder / "journal")
            outcome = "said" if "cannot be checked" in err.getvalue() else "stale"
        except JournalError:
            outcome = "refused"
        counts[outcome] += 1
        if outcome != ("said" if name in RANDOM else "refused"):
            wrong.append(name)
    measured(", ".join(f"{count} {outcome}" for outcome, count in counts.items()))
    assert not wrong


def _simulated(folder: Path, seconds: float, t: Any, a: Any) -> Any:
    """The usual wrapper of a simulator: it writes its input, waits, and reads."""
    path = folder / "input.json"
    path.write_text(json.dumps({"a": float(a)}), encoding="utf-8")
    time.sleep(seconds)
    return json.loads(path.read_text(encoding="utf-8"))["a"] * np.sin(t)


def _fitted(folder: Path, journal: Path | None) -> bytes:
    def simulate(t: Any, a: Any) -> Any:
        return _simulated(folder, SECONDS, t, a)

    model = FunctionModel(simulate, batched=False, rowwise=False, columns=("t",))
    budget = miho.Budget(evaluations=3 * KEPT)
    fit = miho.fit(
        model, t, y, {"a": (0, 4)}, method=miho.optim.RandomSearch(), budget=budget, journal=journal
    )
    return fit.theta.tobytes()


@pytest.mark.fault(
    row="R34",
    fault="SIGKILL of a fit whose model writes a file that its text names",
    promise="the same call goes on, same result to the last bit",
)
def test_a_model_that_writes_files(tmp_path: Path, measured: Figures) -> None:
    """Killed as soon as some evaluations are kept."""
    journal, until = tmp_path / "journal", time.monotonic() + PATIENCE
    begun = forked(partial(_fitted, tmp_path, journal))
    while not journal.is_file() or journal.read_bytes().count(b"\n") <= KEPT:
        assert time.monotonic() < until
        time.sleep(SECONDS)
    os.kill(begun.pid, signal.SIGKILL)
    begun.end()
    kept = journal.read_bytes().count(b"\n") - 1
    same = _fitted(tmp_path, journal) == _fitted(tmp_path, None)
    measured(f"{kept} evaluations kept, {'same' if same else 'another'} result")
    assert same


@pytest.mark.fault(
    row="R35",
    fault="a pipe, a device, a socket, a folder as journal",
    promise="refused in one line, nothing waits",
)
def test_journals_that_are_no_files(tmp_path: Path, measured: Figures) -> None:
    """Each is refused before the model is called."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    os.chdir(tmp_path)  # the name of a socket is at most 108 bytes long
    with socket.socket(socket.AF_UNIX) as server:
        server.bind("socket")
    places = [tmp_path / "pipe", Path("/dev/null"), tmp_path / "socket", tmp_path / "folder"]
    refused: dict[Path, str] = {}

    def fit(place: Path) -> None:
        try:
            _fitted(tmp_path, place)
        except JournalError as error:
            refused[place] = str(error)

    threads = [threading.Thread(target=fit, args=(place,), daemon=True) for place in places]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE)
    lines = [place for place in places if str(place) in refused.get(place, "\n").split("\n")[0]]
    measured(f"{len(lines)} of {len(places)} refused in one line")
    assert lines == places
    assert not (tmp_path / "input.json").exists()
