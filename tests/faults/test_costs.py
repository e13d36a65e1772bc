"""R10 and R11: how long many runs take to read, what one that does nothing costs, and memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from experiments.diagnosis.machine import busy_cores
from tests.faults.commands import CHECKOUT, descendants, started
from tests.faults.conftest import Figures, at_most
from tests.faults.stored_runs import POINTS, make_runs

STORED, RUNS = 10_000, 1000
READ, CURVES = 1.0, 4.0
MEMORY = 500
ALLOWED = 15.0
"""Milliseconds that a run which does nothing may cost."""
PATIENCE = 400.0
"""Seconds after which runs that are not done yet are ended. Hydra's sweeper composes all of them
before the first begins, in 80 ms each, and twice that on a slow day."""
REPEATS = 3
TIMEOUT = 60

PROGRAM = """
import json, resource, sys, time
from miho import load_runs
times = []
for _ in range(int(sys.argv[2])):
    started = time.perf_counter()
    found = load_runs(sys.argv[1])
    runs = len(found.runs)
    read = time.perf_counter()
    rows = len(found.curves)
    times.append((read - started, time.perf_counter() - read))
    counts = [runs, rows, len(found.damaged)]
    del found
memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps([*map(min, zip(*times)), *counts, memory]))
"""


@pytest.mark.timed
@pytest.mark.fault(
    row="R10",
    fault=f"{STORED:,} runs of {POINTS} points",
    promise=f"runs {READ:g} s, curves {CURVES:g} s, {MEMORY} MB",
)
def test_loading(tmp_path: Path, measured: Figures) -> None:
    """Time of `.runs` and then of `.curves` in a new process, and its peak memory.

    Each time is the least of three, since other work on the machine only adds to it. The files were
    just written, so they come from memory, not from the disk. Imports count in the memory, not in
    the times.
    """
    busy = busy_cores()
    make_runs(tmp_path, STORED, np.random.default_rng(0))
    read, curves, *counts, memory = _loaded(tmp_path)
    whole = counts == [STORED, STORED * POINTS, 0]
    measured(
        f"runs {read:.2f} s, curves {curves:.2f} s, {memory:.0f} MB"
        + ("" if whole else "; not all runs were read")
    )
    assert whole
    assert memory <= MEMORY
    for allowed, seconds in ((READ, read), (CURVES, curves)):
        at_most(allowed, seconds, busy)


@pytest.mark.timed
@pytest.mark.fault(
    row="R11",
    fault=f"{RUNS} runs that do nothing",
    promise=f"at most {ALLOWED:g} ms each, flat memory",
)
def test_overhead(tmp_path: Path, measured: Figures) -> None:
    """A thousand runs of one evaluation in one process, and the memory it takes."""
    root, busy = tmp_path / "runs", busy_cores()
    os.sync()  # what others wrote is no business of these runs, which wait for the disk
    process = started(
        "-m", "optimizer=random", "optimizer.batch=1", "budget.evaluations=1",
        f"seed=range({RUNS})", f"root={root}",
    )  # fmt: skip
    sizes: dict[int, list[int]] = {}
    until = time.monotonic() + PATIENCE
    while process.poll() is None and time.monotonic() < until:
        for pid in (process.pid, *descendants(process.pid)):
            sizes.setdefault(pid, []).append(_resident(pid))
        time.sleep(0.2)
    times = sorted(path.stat().st_mtime for path in root.glob("*/*/*/result.json"))
    per_run = 1e3 * (times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else float("inf")
    grown = max(_growth([size for size in series if size]) for series in sizes.values())
    measured(
        f"{per_run:.1f} ms each, {len(times)} done, memory of a process grew by {grown:.0f} MB"
    )
    assert grown < 20
    at_most(ALLOWED, per_run, busy)
    assert process.poll() == 0
    assert len(times) == RUNS


def _loaded(folder: Path) -> list[float]:
    process = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(folder), str(REPEATS)],
        cwd=CHECKOUT,
        capture_output=True, text=True, check=True, timeout=TIMEOUT,
    )  # fmt: skip
    figures: list[float] = json.loads(process.stdout)
    return figures


def _resident(pid: int) -> int:
    """Resident memory in kB, 0 if the process is gone."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith("VmRSS")), 0)


def _growth(series: list[int]) -> float:
    """Megabytes from the middle of a process's life to its end."""
    return (series[-1] - series[len(series) // 2]) / 1024 if len(series) > 3 else 0.0
