"""R3: runs that raise, exit, are killed, find no memory or hang, among others."""

from __future__ import annotations

import json
from pathlib import Path

from experiments.faults.called import identified, prepare
from experiments.faults.row import Row

BAD = ("leave", "exit", "kill", "memory", "hang")
GOOD = 15
"""One of them raises: its values are counted as rejected, and the run finishes."""
MODEL = '''"""A line whose evaluation goes wrong after some calls."""
from experiments.faults.misbehaviour import misbehave

calls = 0


def line(alpha: "rad", *, B: "1/rad", C: "-", D: "N", Sx: "rad", Sy: "N") -> "N":
    global calls
    calls += 1
    if calls > 200:
        misbehave({how!r})
    return Sy - B * D * (alpha - Sx)
'''


def isolation(folder: Path) -> Row:
    """Twenty runs of models in files, five of which go wrong, two at a time."""
    prepare()
    paths = []
    for how in (*BAD, "raise", *(f"good{k}" for k in range(GOOD - 1))):
        path = folder / f"{how}.py"
        path.write_text(MODEL.format(how=how), encoding="utf-8")
        paths.append(str(path))
    ended = identified(
        "-m", "model=function", f"model.path={','.join(paths)}", "dataset.n=40", "optimizer=random",
        "optimizer.batch=1", "budget.evaluations=500", f"root={folder / 'runs'}",
        "sweep.processes=2", "sweep.time_limit=5",
    )  # fmt: skip
    done = len(list((folder / "runs").glob("*/*/*/result.json")))
    told = [
        line
        for line in (ended.out + ended.err).splitlines()
        if line.startswith(("failed:", "lost:"))
    ]
    named = sum(any(f"{how}.py" in line for line in told) for how in BAD)
    results = [json.loads(p.read_text()) for p in (folder / "runs").glob("*/*/*/result.json")]
    rejected = sorted(sum(result["rejected"].values()) for result in results)
    kept = [json.loads(p.read_text()) for p in (folder / "runs").glob("*/*/*/partial.json")]
    traces = sum("Traceback" in str(partial["error"]) for partial in kept)
    return Row(
        "R3", "5 of 20 runs go wrong, one raises", "the other 15 finish, exit 3, a line for each",
        f"{done} of {GOOD} finished, exit {ended.code}, {named} of {len(BAD)} named in {len(told)} "
        f"lines, {traces} tracebacks kept; the one that raises: {rejected[-1:]} values rejected",
        (done, ended.code, named, len(told)) == (GOOD, 3, len(BAD), len(BAD))
        and traces == 2 and rejected[:-1] == [0] * (GOOD - 1) and rejected[-1] > 0,
    )  # fmt: skip
