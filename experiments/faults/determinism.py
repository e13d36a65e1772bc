"""R19: the same seeds with more workers, and after a kill."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import pandas as pd

from experiments.faults.identifying import descendants, identified, started
from experiments.faults.row import Row
from miho.study import load_runs

RUNS = 60
SWEEP = ("-m", "optimizer=miho,pso_100,random", f"seed=range({RUNS // 3})",
         "budget.evaluations=3000")  # fmt: skip


def determinism(folder: Path) -> Row:
    """Sixty runs by one worker, by two, and by two that are killed in the middle and rerun."""
    for name, workers in (("one", 1), ("two", 2)):
        identified(*SWEEP, f"root={folder / name}", f"sweep.processes={workers}")
    root = folder / "killed"
    process = started(*SWEEP, f"root={root}", "sweep.processes=2", out=subprocess.DEVNULL)
    while process.poll() is None and len(list(root.glob("*/*/*/result.json"))) < RUNS // 2:
        time.sleep(0.02)
    family = descendants(process.pid)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    until = time.monotonic() + 5
    while any(Path(f"/proc/{pid}/exe").exists() for pid in family) and time.monotonic() < until:
        time.sleep(0.05)
    orphans = sum(Path(f"/proc/{pid}/exe").exists() for pid in family)
    before = {path: path.read_bytes() for path in root.glob("*/*/*/result.json")}
    code = identified(*SWEEP, f"root={root}", "sweep.processes=2")[0]
    kept = sum(path.read_bytes() == data for path, data in before.items())
    tables = [_table(folder / name) for name in ("one", "two", "killed")]
    equal = all(table.equals(tables[0]) for table in tables)
    return Row(
        "R19", "1 or 2 workers, killed and rerun", "error over evaluations equal bit for bit",
        f"{len(before)} of {RUNS} runs before kill -9, {kept} of them untouched, {orphans} workers "
        f"left, rerun exit {code}; {len(tables[0])} rows of curves equal: {equal}",
        equal and code == 0 and kept == len(before) and not orphans and len(tables[0]) > RUNS,
    )  # fmt: skip


def _table(root: Path) -> pd.DataFrame:
    """The curves without their seconds."""
    columns = ["problem", "optimizer", "seed", "evaluations", "error"]
    curves = load_runs(root).curves[columns]
    return curves.sort_values(columns, kind="stable").reset_index(drop=True)
