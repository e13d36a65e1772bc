"""The command that rows start, as a user would, and what it leaves behind."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

CHECKOUT = Path(__file__).parent.parent.parent
TINY = ("optimizer=random", "budget.evaluations=200")
"""A method and a budget that take a millisecond."""


def started(
    *arguments: str, checkout: Path = CHECKOUT, out: int = subprocess.PIPE
) -> subprocess.Popen[str]:
    """`python -m experiments.identify` with these arguments, in a session of its own."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.Popen(
        [sys.executable, "-m", "experiments.identify", *arguments],
        cwd=checkout,
        env=environment,
        stdout=out,
        stderr=out,
        text=True,
        start_new_session=True,
    )


def identified(
    *arguments: str, checkout: Path = CHECKOUT, seconds: float = 120
) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of that command."""
    process = started(*arguments, checkout=checkout)
    try:
        out, err = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        out, err = process.communicate()
    return process.returncode, out, err


def descendants(pid: int) -> list[int]:
    """Processes that stem from this one, by what /proc says."""
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
