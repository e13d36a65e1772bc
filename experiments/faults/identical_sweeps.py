"""R6: one sweep started twice, in another order, and with the same run twice."""

from __future__ import annotations

import re
from pathlib import Path

from experiments.faults.called import Call, begun, identified, prepare
from experiments.faults.identifying import TINY
from experiments.faults.row import Row
from miho.study import load_runs

SEEDS = 20


def identical_sweeps(folder: Path) -> Row:
    """Two at the same instant; then the seeds backwards and twice."""
    prepare()
    root, forward = f"root={folder / 'runs'}", ",".join(map(str, range(SEEDS)))
    both = [begun(Call(["-m", *TINY, f"seed={forward}", root])) for _ in range(2)]
    ended = [one.end() for one in both]
    codes = [one.code for one in ended]
    ran = sum(_ran(one.out) for one in ended)
    before = {p: p.stat().st_mtime_ns for p in (folder / "runs").glob("*/*/*/result.json")}
    backward = ",".join(map(str, [*reversed(range(SEEDS)), 0, 1]))
    again = identified("-m", *TINY, f"seed={backward}", root)
    touched = sum(path.stat().st_mtime_ns != at for path, at in before.items())
    found = load_runs(folder / "runs")
    right = found.runs["seed"].nunique() == len(found.runs) == SEEDS and not len(found.damaged)
    right = right and codes == [0, 0] and ran == SEEDS
    return Row(
        "R6", "identical sweeps at once, reordered, with repetitions",
        "the second joins, nothing runs twice, no folder is mixed",
        f"exits {codes}, {ran} runs made for {SEEDS}; reordered: exit {again.code}, "
        f"{_ran(again.out)} made, {touched} files touched; {len(found.runs)} rows",
        right and again.code == _ran(again.out) == touched == 0,
    )  # fmt: skip


def _ran(out: str) -> int:
    """How many runs a command says that it made."""
    told = re.search(r"(\d+) ran\b", out)
    return int(told[1]) if told else 0
