"""R22: models that change the process they run in, next to innocent ones."""

from __future__ import annotations

import os
import time
from pathlib import Path

from experiments.doctor.machine import BUSY_CORES, busy_cores
from experiments.faults.called import identified, prepare
from experiments.faults.row import Row
from miho.study import load_runs
from miho.study.workers import Workers

CHANGES = {
    "exp": "np.exp = lambda x: 0.5 * x",
    "folder": "os.chdir('/')",
    "alarm": "signal.alarm(1)",
    "file_size": "resource.setrlimit(resource.RLIMIT_FSIZE, (10, 10))",
    "random": "np.random.seed(0); random.seed(0)",
    "warnings": "np.seterr(all='raise')",
    "handlers": "signal.signal(signal.SIGINT, signal.SIG_IGN)",
    "threads": "os.environ['OMP_NUM_THREADS'] = '7'; sys.setrecursionlimit(150)",
}
"""What a model does to its process, by the name of its file."""
MODEL = '''"""A bump."""
import os, random, resource, signal, sys
import numpy as np
calls = 0

def bump(alpha: "rad", *, B: "1/rad", C: "-", D: "N", Sx: "rad", Sy: "N") -> "N":
    global calls
    calls += 1
    if calls == 20:
        {change}
    return Sy - D * np.exp(-((B * (alpha - Sx)) ** 2))
'''
SWEEP = ("model=function", "dataset.n=40", "optimizer=random", "optimizer.batch=1")
SEEDS, JOBS, ALLOWED = 3, 40, 5.0


def neighbours(folder: Path) -> Row:
    """Eight bad models, an innocent one after each, three seeds, one worker; a relative root."""
    prepare()
    paths = {name: folder / f"{name}.py" for name in CHANGES}
    innocent = {f"innocent_{name}": folder / f"innocent_{name}.py" for name in CHANGES}
    for name, change in CHANGES.items():
        paths[name].write_text(MODEL.format(change=change), encoding="utf-8")
        innocent[f"innocent_{name}"].write_text(MODEL.format(change="pass"), encoding="utf-8")
    order = [path for pair in zip(paths.values(), innocent.values(), strict=True) for path in pair]
    beside, root_alone = folder / "beside", folder / "alone"
    ended = _sweep(order, Path(os.path.relpath(beside)), "sweep.time_limit=30")
    _sweep([folder / "innocent_exp.py"], root_alone)
    expected = load_runs(root_alone).runs.set_index("seed")["error"].to_dict()
    runs = load_runs(beside).runs
    configs = {
        path: path.with_name("config.json").read_text() for path in beside.rglob("result.json")
    }
    clean = {str(path.parent) for path, text in configs.items() if "innocent_" in text}
    ours = runs[[str(one) in clean for one in runs["folder"]]]
    equal = sum(
        expected[seed] == error for seed, error in zip(ours["seed"], ours["error"], strict=True)
    )
    wanted = SEEDS * len(innocent)
    cost = 1e3 * (_seconds(alone=True) - _seconds(alone=False))
    busy = (busy_cores() or 0.0) > BUSY_CORES
    unjudged = " (not judged, the machine is busy)" * (busy and cost > ALLOWED)
    return Row(
        "R22",
        f"{len(CHANGES)} models that change their process (np.exp, folder, alarm, limits, random "
        "numbers, handlers), each before an innocent one",
        f"innocent runs equal bit for bit to those alone, none lost; at most {ALLOWED:g} ms a run",
        f"{equal} of {wanted} innocent runs equal, {len(runs)} of {2 * wanted} done, exit "
        f"{ended}; a process of its own takes {cost:.1f} ms at best, {1e3 * _forking():.1f} ms of "
        f"them the system's own for a fork and its end{unjudged}",
        equal == len(ours) == wanted and (cost <= ALLOWED or busy),
    )


def _sweep(models: list[Path], root: Path, *more: str) -> int:
    paths = ",".join(map(str, models))
    seeds = f"seed=range({SEEDS})"
    given = ("budget.evaluations=300", f"model.path={paths}", f"root={root}", seeds, *more)
    return identified("-m", *SWEEP, *given).code


def _forking() -> float:
    """The shortest time of a fork of a process of this size that ends at once."""
    took = []
    for _ in range(JOBS):
        began = time.perf_counter()
        child = os.fork()
        if not child:
            os._exit(0)
        os.waitpid(child, 0)
        took.append(time.perf_counter() - began)
    return min(took)


def _seconds(*, alone: bool) -> float:
    """The shortest time of a job that does nothing."""
    took = []
    modules = ("experiments.sweep",)
    workers: Workers[int, int] = Workers(abs, 1, modules=modules, alone=bool if alone else None)
    with workers:
        for job in range(1, JOBS + 1):
            began = time.perf_counter()
            workers.start(job)
            while not workers.wait(1.0):
                pass
            took.append(time.perf_counter() - began)
    return min(took)
