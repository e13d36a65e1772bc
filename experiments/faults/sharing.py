"""R5: many processes on one folder of results, some of which are killed."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path

from experiments.faults.row import Row
from experiments.faults.trivial import begun, do, forked
from miho.study import Status, load_runs

PROCESSES, RUNS, KILLED = 8, 800, 3


def sharing(folder: Path) -> Row:
    """Eight processes share 800 runs, three are killed, one call does the rest."""
    root, log = folder / "runs", folder / "log"
    children = [forked(_share, root, log, folder, k) for k in range(PROCESSES)]
    chance = random.Random(5)
    for child in children[:KILLED]:
        time.sleep(chance.uniform(0.1, 0.5))
        os.kill(child, signal.SIGKILL)
    for child in children:
        os.waitpid(child, 0)
    finished = {path.parent.name for path in root.glob("*/*/*/result.json")}
    errors = sum(1 for _ in folder.glob("error*"))
    _share(root, log, folder, PROCESSES)
    runs = load_runs(root).runs
    extra = begun(log).total() - RUNS
    whole = len(runs) == RUNS == runs["id"].nunique()
    return Row(
        "R5", "8 processes on one root, 3 killed", "all rows after one rerun, each run done once",
        f"{len(finished)} runs before the rerun, {len(runs)} after it, {runs['id'].nunique()} ids, "
        f"{errors} errors, {extra} begun again (at most {KILLED} were cut short)",
        whole and errors == 0 and 0 <= extra <= KILLED,
    )  # fmt: skip


def _share(root: Path, log: Path, folder: Path, number: int) -> None:
    """Do what nobody else does, in an order of one's own, until all is done."""
    seeds = list(range(RUNS))
    random.Random(number).shuffle(seeds)
    try:
        while seeds:
            busy = [s for s in seeds if do(root, s, log).status is Status.RUNNING_ELSEWHERE]
            if len(busy) == len(seeds):
                time.sleep(0.01)
            seeds = busy
    except Exception as error:  # noqa: BLE001 -- what must not happen is counted
        (folder / f"error{number}").write_text(repr(error), encoding="utf-8")
