"""R11: what a run costs that does nothing."""

from __future__ import annotations

import os
import time
from pathlib import Path

from experiments.faults.identifying import descendants, started
from experiments.faults.row import Row

RUNS = 1000


def overhead(folder: Path) -> Row:
    """A thousand runs of one evaluation in one process, and the memory it takes."""
    root = folder / "runs"
    os.sync()  # what others wrote is no business of these runs, which wait for the disk
    process = started(
        "-m", "optimizer=random", "optimizer.batch=1", "budget.evaluations=1",
        f"seed=range({RUNS})", f"root={root}",
    )  # fmt: skip
    sizes: dict[int, list[int]] = {}
    while process.poll() is None:
        for pid in (process.pid, *descendants(process.pid)):
            sizes.setdefault(pid, []).append(_resident(pid))
        time.sleep(0.2)
    times = sorted(path.stat().st_mtime for path in root.glob("*/*/*/result.json"))
    per_run = 1e3 * (times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else float("inf")
    grown = max(_growth([size for size in series if size]) for series in sizes.values())
    return Row(
        "R11", f"{RUNS} runs that do nothing", "at most 15 ms each, flat memory",
        f"{per_run:.1f} ms each, {len(times)} done, memory of a process grew by {grown:.0f} MB",
        per_run <= 15 and len(times) == RUNS and process.returncode == 0 and grown < 20,
    )  # fmt: skip


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
