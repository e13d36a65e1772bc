"""R6, R19 and R26: the same runs come out, whatever makes them, in any order and surroundings."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pandas as pd
import pytest

from miho.study import load_runs
from miho.study.environment import ARITHMETIC
from tests.faults.commands import (
    CHECKOUT,
    TINY,
    Call,
    alive,
    begun,
    called,
    descendants,
    identified,
    prepare,
)
from tests.faults.conftest import Figures

SEEDS = 20
RUNS, FEWER_RUNS = 60, 12
SWEEP = ("-m", "optimizer=miho,pso_100,random", "budget.evaluations=3000", "dataset.n=100")

VERSIONS = ("3.11", "3.12", "3.13", "3.14")
DIGEST = """
import ast, hashlib, pathlib, runpy
meaning_of = runpy.run_path("experiments/app/meaning.py")["meaning_of"]
trees = [ast.parse(file.read_bytes()) for file in sorted(pathlib.Path("miho").rglob("*.py"))]
print(hashlib.sha256("".join(map(meaning_of, trees)).encode()).hexdigest())
"""
SURROUNDINGS = {
    "as it is": {},
    "2 threads": {"OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2", "PYTHONHASHSEED": "1"},
    "locale C": {"LC_ALL": "C", "PYTHONHASHSEED": "2", "OPENBLAS_NUM_THREADS": "1"},
    "kernel Prescott": {"OPENBLAS_CORETYPE": "Prescott"},
}


@pytest.mark.slow
@pytest.mark.fault(
    row="R6",
    fault="identical sweeps at once, reordered, with repetitions",
    promise="the second joins, nothing runs twice, no folder is mixed",
)
def test_identical_sweeps(tmp_path: Path, measured: Figures) -> None:
    """Two at the same instant; then the seeds backwards and twice."""
    prepare()
    root, forward = f"root={tmp_path / 'runs'}", ",".join(map(str, range(SEEDS)))
    sweeps = [begun(Call(["-m", *TINY, f"seed={forward}", root])) for _ in range(2)]
    ended = [sweep.end() for sweep in sweeps]
    codes = [sweep.code for sweep in ended]
    ran = sum(_ran(sweep.out) for sweep in ended)
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "runs").glob("*/*/*/result.json")}
    backward = ",".join(map(str, [*reversed(range(SEEDS)), 0, 1]))
    again = identified("-m", *TINY, f"seed={backward}", root)
    touched = sum(path.stat().st_mtime_ns != at for path, at in before.items())
    stored = load_runs(tmp_path / "runs")
    measured(
        f"exits {codes}, {ran} runs made for {SEEDS}; reordered: exit {again.code}, "
        f"{_ran(again.out)} made, {touched} files touched; {len(stored.runs)} rows"
    )
    assert codes == [0, 0]
    assert ran == SEEDS
    assert stored.runs["seed"].nunique() == len(stored.runs) == SEEDS
    assert stored.damaged.empty
    assert again.code == _ran(again.out) == touched == 0


@pytest.mark.slow
@pytest.mark.fault(
    row="R19",
    fault="1 or 2 workers, killed and rerun",
    promise="error over evaluations equal bit for bit",
)
def test_workers_and_a_kill_change_nothing(
    tmp_path: Path, measured: Figures, thorough: bool
) -> None:
    """As many runs by one worker, by two, and by two that are killed in the middle and rerun."""
    prepare()
    times = RUNS if thorough else FEWER_RUNS
    wanted = (*SWEEP, f"seed=range({times // 3})")
    for name, workers in (("one", 1), ("two", 2)):
        identified(*wanted, f"root={tmp_path / name}", f"sweep.workers={workers}")
    root = tmp_path / "killed"
    serving = set(descendants(os.getpid()))
    sweep = begun(Call([*wanted, f"root={root}", "sweep.workers=2"]))
    until = time.monotonic() + 60
    while len(list(root.glob("*/*/*/result.json"))) < times // 2 and time.monotonic() < until:
        time.sleep(0.02)
    family = [pid for pid in descendants(os.getpid()) if pid not in serving]
    os.kill(sweep.pid, signal.SIGKILL)
    sweep.end()
    until = time.monotonic() + 5
    while (orphans := len(alive(family))) and time.monotonic() < until:
        time.sleep(0.05)
    before = {path: path.read_bytes() for path in root.glob("*/*/*/result.json")}
    code = identified(*wanted, f"root={root}", "sweep.workers=2").code
    untouched = sum(path.read_bytes() == data for path, data in before.items())
    tables = [_table(tmp_path / name) for name in ("one", "two", "killed")]
    equal = all(table.equals(tables[0]) for table in tables)
    measured(
        f"{len(before)} of {times} runs before kill -9, {untouched} of them untouched, {orphans} "
        f"of {len(family)} processes left, rerun exit {code}; {len(tables[0])} rows of curves "
        f"equal: {equal}"
    )
    assert equal
    assert code == 0
    assert untouched == len(before)
    assert len(family) > 1
    assert not orphans
    assert len(tables[0]) > times


@pytest.mark.slow
@pytest.mark.fault(
    row="R26",
    fault="other Pythons; 1 or 2 threads, hash seeds, locales, another kernel of BLAS",
    promise="one identity; bit-equal where CPU and kernel agree, recorded where not",
)
def test_other_machines(tmp_path: Path, measured: Figures) -> None:
    """The digest of all code by each Python here; one run in other surroundings."""
    digests = {version: digest for version in VERSIONS if (digest := _digest(version))}
    found = {name: _run(tmp_path / name, more) for name, more in SURROUNDINGS.items()}
    _, usual_curve, usual_kernel = found["as it is"]
    identities = {identity for identity, _, _ in found.values()}
    alike = [curve for _, curve, kernel in found.values() if kernel == usual_kernel]
    equal = sum(curve == usual_curve for curve in alike)
    kernels = len({str(kernel) for _, _, kernel in found.values()})
    measured(
        f"{len(set(digests.values()))} digest by {', '.join(digests)}; {len(identities)} identity "
        f"of {len(found)} runs; {equal} of {len(alike)} on the same kernel equal bit for bit; "
        f"{kernels} kernels recorded"
    )
    assert len(set(digests.values())) == len(identities) == 1
    assert equal == len(alike) > 2


def _ran(out: str) -> int:
    """How many runs a command says that it made."""
    number = re.search(r"(\d+) ran\b", out)
    return int(number[1]) if number else 0


def _table(root: Path) -> pd.DataFrame:
    """The curves without their seconds."""
    columns = ["problem", "optimizer", "seed", "evaluations", "error"]
    curves = load_runs(root).curves[columns]
    return curves.sort_values(columns, kind="stable").reset_index(drop=True)


def _digest(version: str) -> str | None:
    """By the Python of this version, if one is installed, beside those of pyenv as well."""
    beside = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    places = [*map(str, sorted(beside.glob(f"{version}.*/bin/python")))]
    python = places[0] if places else shutil.which(f"python{version}")
    if python is None:
        return None
    process = subprocess.run(
        [python, "-I", "-c", DIGEST], cwd=CHECKOUT, capture_output=True, text=True, check=False
    )
    return process.stdout.strip() or None


def _run(root: Path, more: dict[str, str]) -> tuple[str, object, list[object]]:
    """Identity, error over evaluations, and what the run says of its arithmetic."""
    call = Call(["-m", *TINY, "optimizer=least_squares", f"root={root}"])
    (ended,) = called([call], {**os.environ, **more})
    if ended.code:
        raise RuntimeError(ended.err)
    runs = load_runs(root)
    environment = json.loads(next(root.rglob("environment.json")).read_bytes())
    curve = runs.curves[["evaluations", "error"]].to_numpy().tolist()
    return runs.runs["id"].item(), curve, [environment[name] for name in ARITHMETIC]
