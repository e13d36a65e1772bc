"""R10: how long many runs take to read, and how much memory."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from experiments.faults.made_runs import POINTS, make_runs
from experiments.faults.row import Row
from miho.study.compaction import compact

RUNS = 10_000
READ, COLD, COMPACTED = 1.0, 4.0, 0.5
MEMORY = 500
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


def loading(folder: Path, count: int = RUNS) -> Row:
    """Time of `.runs` and then of `.curves` in a new process, and its peak memory.

    Each time is the least of three, since other work on the machine only adds to it. The files were
    just written, so they come from memory, not from the disk. Imports count in the memory, not in
    the times.
    """
    make_runs(folder, count, np.random.default_rng(0))
    read, cold, *first = _measured(folder)
    compact(folder)
    again, fast, *second = _measured(folder)
    memory = max(first[-1], second[-1])
    whole = all(counts[:3] == [count, count * POINTS, 0] for counts in (first, second))
    in_time = max(read, again) <= READ and cold <= COLD and fast <= COMPACTED
    return Row(
        "R10",
        f"{count:,} runs of {POINTS} points",
        f"runs {READ:g} s, curves {COLD:g} s, compacted {COMPACTED:g} s, {MEMORY} MB",
        f"runs {max(read, again):.2f} s, curves {cold:.2f} s, compacted {fast:.2f} s, "
        f"{memory:.0f} MB" + ("" if whole else "; not all runs were read"),
        whole and in_time and memory <= MEMORY,
    )


def _measured(folder: Path) -> list[float]:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(folder), str(REPEATS)],
        cwd=Path(__file__).parent.parent.parent,
        capture_output=True, text=True, check=True, timeout=TIMEOUT,
    )  # fmt: skip
    figures: list[float] = json.loads(done.stdout)
    return figures
