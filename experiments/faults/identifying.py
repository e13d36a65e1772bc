"""The command that rows start, as a user would, and what it leaves behind."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

CHECKOUT = Path(__file__).parent.parent.parent
TINY = ("optimizer=random", "budget.evaluations=200", "dataset.n=40")
"""A method, a budget and data that take a millisecond."""


def started(*arguments: str) -> subprocess.Popen[bytes]:
    """`python -m experiments.identify` in a session of its own, from a fresh interpreter."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.Popen(
        [sys.executable, "-m", "experiments.identify", *arguments],
        cwd=CHECKOUT,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def descendants(pid: int) -> list[int]:
    """Processes that stem from this one and have not ended, by what /proc says."""
    parents: dict[int, int] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text(encoding="utf-8").rpartition(")")[2].split()
        except OSError:
            continue
        if fields[0] != "Z":
            parents[int(stat.parent.name)] = int(fields[1])
    found, open_ones = [], [pid]
    while open_ones:
        children = [child for child, parent in parents.items() if parent == open_ones[0]]
        found += children
        open_ones = [*open_ones[1:], *children]
    return found


def alive(pids: list[int]) -> list[int]:
    """Those that have not ended."""
    found = []
    for pid in pids:
        try:
            stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
        except OSError:
            continue
        if stat.rpartition(")")[2].split()[0] != "Z":
            found.append(pid)
    return found
