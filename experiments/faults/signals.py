"""R4: a sweep that is told to stop."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from pathlib import Path

from experiments.faults.identifying import descendants, identified, started
from experiments.faults.row import Row

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)
ROUNDS = 1
SWEEP = ("-m", "optimizer=random", "seed=0,1,2", "budget.evaluations=null", "budget.seconds=60",
         "sweep.processes=2")  # fmt: skip


def signals(folder: Path) -> Row:
    """Signal sweeps at random times; then one twice, which must end at once."""
    chance = random.Random(4)
    slowest = orphans = wrong = kept = 0.0
    for number in SIGNALS * ROUNDS:
        root = folder / f"{number.name}{chance.random():.6f}"
        taken, left, code = _stopped(root, number, chance.uniform(0, 1.5), twice=False)
        slowest, orphans = max(slowest, taken), orphans + left
        wrong += code != 128 + number
        kept += len(list(root.glob("*/*/*/partial.json"))) == 2
    twice, left, _ = _stopped(folder / "twice", signal.SIGINT, 0.5, twice=True)
    again = identified(*SWEEP, f"root={folder / 'twice'}", "budget.seconds=0.2")[0]
    sent = len(SIGNALS) * ROUNDS
    return Row(
        "R4", "SIGINT, SIGTERM, SIGUSR1 to a sweep",
        "all processes gone in 5 s, partial curves kept, rerun resumes; a second one ends at once",
        f"{sent} signals: gone in {slowest:.1f} s at most, {orphans + left:.0f} left, {kept:.0f} "
        f"of {sent} kept both curves, {wrong:.0f} wrong exit codes; second: {twice:.1f} s; rerun "
        f"exit {again}",
        slowest <= 5 and not orphans + left and kept == sent and not wrong and twice <= 2
        and again == 0,
    )  # fmt: skip


def _stopped(root: Path, number: int, wait: float, *, twice: bool) -> tuple[float, int, int]:
    """Seconds until a sweep was gone, how many of its processes were left, and its exit code."""
    process = started(*SWEEP, f"root={root}", out=subprocess.DEVNULL)
    until = time.monotonic() + 60
    while len(list(root.glob("*/*/*/lock"))) < 2 and time.monotonic() < until:
        time.sleep(0.05)
    time.sleep(wait)
    family = descendants(process.pid)
    os.kill(process.pid, number)
    if twice:
        time.sleep(0.05)
        os.kill(process.pid, number)
    began = time.monotonic()
    while _alive(family) and time.monotonic() < began + 20:
        time.sleep(0.02)
    process.communicate(timeout=20)
    taken, left = time.monotonic() - began, _alive(family)
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    return taken, len(left), process.returncode


def _alive(pids: list[int]) -> list[int]:
    alive = []
    for pid in pids:
        try:
            stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
        except OSError:
            continue
        if stat.rpartition(")")[2].split()[0] != "Z":
            alive.append(pid)
    return alive
