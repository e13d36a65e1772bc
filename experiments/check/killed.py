"""Evaluations that an expensive run loses if it is killed and continued twenty times.

python -m experiments.check.killed [METHOD:WORKERS ...]    # default: all, about ten minutes

Each run makes 200 evaluations of 0.2 s with a function in a file: once undisturbed, and once killed
with SIGKILL twenty times at random times, some of them before its first evaluation. The function
counts its calls. Exits with 1 if the killed run makes more than 10 % more evaluations, or if its
result differs in any bit.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.app.build import build
from experiments.app.compose import composed
from experiments.app.console import run_and_exit
from experiments.app.plan import request_of
from experiments.app.runs import run
from experiments.app.schema import SweepConfig, register
from miho.optim.seeds import stream

RUNS = ("miho:1", "miho:4", "miho_gn:1", "miho_gn:4", "pso_constriction:1", "pso_constriction:4")
EVALUATIONS, SECONDS, KILLS, MOST = 200, 0.2, 20, 1.1
LIMIT = 600.0
"""Time [s] after which a process counts as hung."""
POLL, EARLY = 0.01, 0.25
MODEL = f"""
import os, time
import numpy as np

def decay(t: "s", *, a: "V", b: "1/s", c: "V") -> "V":
    a, b, c = float(a), float(b), float(c)  # which no formula can be traced through
    _count("begun")
    time.sleep({SECONDS})
    _count("ended")
    return a * np.exp(-b * t) + c

def _count(name):
    path = os.path.join(os.path.dirname(__file__), name)
    descriptor = os.open(path, os.O_APPEND | os.O_CREAT | os.O_WRONLY)
    os.write(descriptor, b".")
    os.close(descriptor)
"""


class Calls(NamedTuple):
    """Number of started evaluations, and number of finished ones."""

    begun: int
    ended: int

    @classmethod
    def of(cls, folder: Path) -> Calls:
        """Read the counts that the function wrote to a folder."""
        paths = (folder / "begun", folder / "ended")
        return cls(*(path.stat().st_size if path.is_file() else 0 for path in paths))


def search(folder: Path, method: str, workers: str) -> None:
    """Execute a run in this process, unless it is stored, as `experiments.identify` does."""
    register()
    bounds = "{a: {unit: V, low: 0, high: 5}, b: {unit: 1/s, low: 0.1, high: 5}, "
    cfg = composed([
        "model=function", f"model.path={folder}/decay.py", "model.function=decay",
        "model.batched=false", "dataset=csv", f"dataset.path={folder}/data.csv",
        "dataset.columns=[t,U]", "dataset.units=[s,V]", "dataset.output=U",
        f"space={bounds}c: {{unit: V, low: -1, high: 2}}}}", f"optimizer={method}",
        f"budget.evaluations={EVALUATIONS}", f"workers={workers}", f"root={folder}/runs",
    ])  # fmt: skip
    run([request_of(build(cfg), cfg)], SweepConfig(), here=True).raise_if_stopped()


def prepared(folder: Path) -> Path:
    """Write a model and data to a folder."""
    folder.mkdir()
    (folder / "decay.py").write_text(MODEL)
    t = np.linspace(0, 5, 20)
    U = 1.6 * np.exp(-0.8 * t) + 0.4 + 0.02 * stream("killed").standard_normal(t.size)
    np.savetxt(folder / "data.csv", np.column_stack([t, U]), "%.6g", ",", header="t,U", comments="")
    return folder


def started(folder: Path, method: str, workers: str) -> subprocess.Popen[bytes]:
    """Start the process of a run."""
    command = [sys.executable, "-m", "experiments.check.killed"]
    return subprocess.Popen(
        [*command, "--child", str(folder), method, workers], stderr=subprocess.DEVNULL
    )


def result_of(folder: Path) -> dict[str, Any] | None:
    """Result of a run without its cost; None if it is not finished."""
    for path in folder.glob("runs/*/*/*/result.json"):
        result = json.loads(path.read_text())
        curve = json.loads(path.with_name("curve.json").read_text())
        values = {name: result[name] for name in ("loss", "theta", "evaluations", "outcome")}
        return values | {name: curve[name] for name in ("evaluations", "loss", "theta")}
    return None


def undisturbed(folder: Path, method: str, workers: str) -> float:
    """Make a run without kills; return the seconds until its first evaluation."""
    begun = time.perf_counter()
    process = started(folder, method, workers)
    while not Calls.of(folder).begun and process.poll() is None:
        time.sleep(POLL)
    first = time.perf_counter() - begun
    process.wait(LIMIT)
    return first


def killed(folder: Path, method: str, workers: str, first: float) -> int:
    """Make a run that is killed KILLS times and then finished; return the number of kills.

    A quarter of the kills come before the first evaluation of the process.
    """
    rng = stream("killed", method, workers)
    share = EVALUATIONS * SECONDS / int(workers) / KILLS
    kills = 0
    for _ in range(KILLS):
        before = Calls.of(folder).begun
        process = started(folder, method, workers)
        early, later = rng.uniform(0.0, 0.8 * first), rng.uniform(0.0, 1.6 * share)
        strikes_early = rng.random() < EARLY
        while not strikes_early and Calls.of(folder).begun == before and process.poll() is None:
            time.sleep(POLL)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(early if strikes_early else later)
            break
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        kills += 1
    started(folder, method, workers).wait(LIMIT)
    return kills


def check(name: str, top: Path) -> bool:
    """Print the cost of killing one run; return whether the check passed."""
    method, _, workers = name.partition(":")
    plain, other = prepared(top / f"{method}-{workers}"), prepared(top / f"{method}-{workers}-k")
    first = undisturbed(plain, method, workers)
    kills = killed(other, method, workers, first)
    calls, more = Calls.of(plain), Calls.of(other)
    alike = result_of(plain) is not None and result_of(plain) == result_of(other)
    print(
        f"{method}, workers={workers}: {calls.ended} evaluations undisturbed; killed {kills} times "
        f"{more.ended} ({more.begun} begun); {'the same result' if alike else 'ANOTHER RESULT'}",
        flush=True,
    )
    return alike and more.ended <= MOST * calls.ended


def main() -> None:
    """Check all runs, or execute one as the process that is killed."""
    if sys.argv[1:2] == ["--child"]:
        folder, method, workers = sys.argv[2:]
        search(Path(folder), method, workers)
        return
    with tempfile.TemporaryDirectory() as top:
        passed = [check(name, Path(top)) for name in sys.argv[1:] or RUNS]
    if not all(passed):
        print("missed: more than a tenth more evaluations, or another result")
        sys.exit(1)


if __name__ == "__main__":
    run_and_exit(main)
