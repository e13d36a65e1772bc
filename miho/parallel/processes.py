"""Detect the end of processes, and end processes with their descendants."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

SET_CHILD_SUBREAPER = 36
"""PR_SET_CHILD_SUBREAPER of Linux; see prctl(2)."""
ROUNDS = 10
"""Number of searches for descendants of a process, which may fork while they are killed."""


def adopt_orphans() -> None:
    """Keep the descendants of this process as such even if a process in between ends.

    Only Linux supports this. On other systems, processes that a child starts in a new session
    outlive it.
    """
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def end_child(child: int) -> int:
    """Kill a child of this process, its group and its orphans; return its wait status."""
    _kill(child)
    _, status = os.waitpid(child, 0)
    with contextlib.suppress(ChildProcessError):  # no orphans are left
        while True:
            if os.waitpid(-1, os.WNOHANG)[0] == 0:
                for orphan in descendants(os.getpid()):
                    _kill(orphan)
    return status


def end_family(*processes: int) -> None:
    """Kill processes and their descendants by /proc, or their groups on systems without /proc."""
    for _ in range(ROUNDS):
        family = descendants(*processes)
        for member in family:
            _kill(member)
        if not family:
            break
    for process in processes:
        _kill(process)


def descendants(*processes: int) -> list[int]:
    """Descendants of processes that have not ended, by /proc."""
    parents: dict[int, int] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        fields = _fields(stat)
        if fields and fields[0] not in "ZX":
            parents[int(stat.parent.name)] = int(fields[1])
    offspring, waiting = [], list(processes)
    while waiting:
        children = [child for child, parent in parents.items() if parent == waiting[0]]
        offspring += children
        waiting = [*waiting[1:], *children]
    return offspring


def child_has_ended(child: int) -> bool:
    """Return whether a child has ended and its status is still to be read."""
    return os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


@contextmanager
def end_of(child: int) -> Iterator[list[int]]:
    """Yield a descriptor that becomes readable when a child ends; empty if the system has none."""
    try:
        descriptor = os.pidfd_open(child)
    except (AttributeError, OSError):
        yield []
        return
    try:
        yield [descriptor]
    finally:
        os.close(descriptor)


def _kill(process: int) -> None:
    """Kill a process, and its group if it leads one."""
    for kill in (os.killpg, os.kill):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            kill(process, signal.SIGKILL)


def _fields(stat: Path) -> list[str]:
    """State, parent and further fields of a process; empty if it has ended."""
    try:
        return stat.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    except OSError:
        return []
