"""R19: the same seeds with more workers, and after a kill."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pandas as pd

from experiments.faults.called import Call, begun, identified, prepare
from experiments.faults.identifying import alive, descendants
from experiments.faults.row import Row
from miho.study import load_runs

RUNS = 60
SWEEP = ("-m", "optimizer=miho,pso_100,random", "budget.evaluations=3000", "dataset.n=100")


def determinism(folder: Path, times: int = RUNS) -> Row:
    """As many runs by one worker, by two, and by two that are killed in the middle and rerun."""
    prepare()
    wanted = (*SWEEP, f"seed=range({times // 3})")
    for name, workers in (("one", 1), ("two", 2)):
        identified(*wanted, f"root={folder / name}", f"sweep.processes={workers}")
    root = folder / "killed"
    serving = set(descendants(os.getpid()))
    sweep = begun(Call([*wanted, f"root={root}", "sweep.processes=2"]))
    until = time.monotonic() + 60
    while len(list(root.glob("*/*/*/result.json"))) < times // 2 and time.monotonic() < until:
        time.sleep(0.02)
    family = [pid for pid in descendants(os.getpid()) if pid not in serving]
    os.kill(sweep.pid, signal.SIGKILL)
    sweep.end()
    until = time.monotonic() + 5
    while (orphans := len(alive(family))) and time.monotonic() < until:
        time.sleep(0.05)
    before = {path: path.read_bytes() for path in root.glob("*/*/*/result.json")}
    code = identified(*wanted, f"root={root}", "sweep.processes=2").code
    kept = sum(path.read_bytes() == data for path, data in before.items())
    tables = [_table(folder / name) for name in ("one", "two", "killed")]
    equal = all(table.equals(tables[0]) for table in tables)
    return Row(
        "R19", "1 or 2 workers, killed and rerun", "error over evaluations equal bit for bit",
        f"{len(before)} of {times} runs before kill -9, {kept} of them untouched, {orphans} of "
        f"{len(family)} processes left, rerun exit {code}; {len(tables[0])} rows of curves equal: "
        f"{equal}",
        equal and code == 0 and kept == len(before) and len(family) > 1 and not orphans
        and len(tables[0]) > times,
    )  # fmt: skip


def _table(root: Path) -> pd.DataFrame:
    """The curves without their seconds."""
    columns = ["problem", "optimizer", "seed", "evaluations", "error"]
    curves = load_runs(root).curves[columns]
    return curves.sort_values(columns, kind="stable").reset_index(drop=True)
