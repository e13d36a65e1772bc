"""An expensive run that is killed several times loses few evaluations, and its result is the same.

The function in a file counts its calls in the file `calls` next to it.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments.app.build import build
from experiments.app.compose import composed
from experiments.app.plan import request_of
from experiments.app.runs import run
from experiments.app.schema import SweepConfig
from miho.optim.seeds import stream

EVALUATIONS, SECONDS, KILLS = 120, 0.05, 4
AGAIN = 2
"""Evaluations that the next call repeats to check that the model is the same."""
LIMIT = 120.0
MODEL = f"""
import time
from pathlib import Path

import numpy as np

def decay(t: "s", *, a: "V", b: "1/s", c: "V") -> "V":
    a, b, c = float(a), float(b), float(c)  # which no formula can be traced through
    time.sleep({SECONDS})
    with Path(__file__).with_name("calls").open("a") as file:
        file.write(".")
    return a * np.exp(-b * t) + c
"""


SEARCH = "import sys; from tests.experiments.test_killed_runs import search; search(*sys.argv[1:])"


def search(folder: str, method: str, workers: str) -> None:
    """Execute a run in this process, unless it is stored, as `experiments.identify` does."""
    bounds = "{a: {unit: V, low: 0, high: 5}, b: {unit: 1/s, low: 0.1, high: 5}, "
    cfg = composed([
        "model=function", f"model.path={folder}/decay.py", "model.function=decay",
        "model.batched=false", "dataset=csv", f"dataset.path={folder}/data.csv",
        "dataset.columns=[t,U]", "dataset.units=[s,V]", "dataset.output=U",
        f"space={bounds}c: {{unit: V, low: -1, high: 2}}}}", f"optimizer={method}",
        f"budget.evaluations={EVALUATIONS}", f"workers={workers}", f"root={folder}/runs",
    ])  # fmt: skip
    run([request_of(build(cfg), cfg)], SweepConfig(), here=True).raise_if_stopped()


def command(folder: Path, method: str, workers: int) -> list[str]:
    """Write a model and data to a folder; return the command of the search."""
    folder.mkdir()
    (folder / "decay.py").write_text(MODEL)
    t = np.linspace(0, 5, 20)
    U = 1.6 * np.exp(-0.8 * t) + 0.4 + 0.02 * stream("killed").standard_normal(t.size)
    np.savetxt(folder / "data.csv", np.column_stack([t, U]), "%.6g", ",", header="t,U", comments="")
    return [sys.executable, "-c", SEARCH, str(folder), method, str(workers)]


def calls(folder: Path) -> int:
    """Number of finished evaluations."""
    path = folder / "calls"
    return path.stat().st_size if path.is_file() else 0


def kill(folder: Path, line: list[str], seconds: float) -> bool:
    """Start a run and kill it `seconds` after its next evaluation; whether it had not ended."""
    before, began = calls(folder), time.monotonic()
    with subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        while calls(folder) == before and process.poll() is None:
            assert time.monotonic() < began + LIMIT
            time.sleep(0.01)
        time.sleep(seconds)
        process.kill()
    return process.returncode != 0


def result(folder: Path) -> dict[str, Any]:
    """Result of the run without its cost."""
    (path,) = folder.glob("runs/*/*/*/result.json")
    stored = json.loads(path.read_text())
    curve = json.loads(path.with_name("curve.json").read_text())
    values = {name: stored[name] for name in ("loss", "theta", "outcome")}
    return values | {name: curve[name] for name in ("evaluations", "loss", "theta")}


@pytest.mark.slow
@pytest.mark.parametrize(("method", "workers"), [("miho", 1), ("miho_gn", 4)])
def test_only_evaluations_in_progress_are_lost(tmp_path: Path, method: str, workers: int) -> None:
    """At most those in progress at each kill, and those that check the model."""
    plain, other = tmp_path / "plain", tmp_path / "killed"
    subprocess.run(command(plain, method, workers), check=True, capture_output=True)
    alone = calls(plain)
    line = command(other, method, workers)
    share = alone * SECONDS / workers / KILLS
    times = stream("killed", method).uniform(0.0, 1.2 * share, KILLS)
    kills = sum(kill(other, line, float(seconds)) for seconds in times)
    subprocess.run(line, check=True, capture_output=True)
    assert kills >= KILLS - 1
    assert calls(other) - alone <= (AGAIN + workers) * KILLS
    assert result(other) == result(plain)
