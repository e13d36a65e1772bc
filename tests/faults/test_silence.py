"""R25: what went wrong without a word."""

from __future__ import annotations

import json
import os
import signal
import time
from multiprocessing import forkserver
from pathlib import Path

import pytest

from experiments.diagnosis.results import result_checks
from miho.parallel.workers import Workers
from tests.faults.commands import TINY, Call, begun, identified, prepare
from tests.faults.conftest import Figures

NEVER = '''"""A line that cannot be evaluated in a run, though it can be tried."""
import inspect

def line(alpha: "rad", *, B: "1/rad", C: "-", D: "N", Sx: "rad", Sy: "N") -> "N":
    if not any(frame.function == "__post_init__" for frame in inspect.stack()):
        raise NameError("gone")
    return Sy - B * D * (alpha - Sx)
'''
COUNTED = '''"""A line that counts its evaluations in a file."""

def line(alpha: "rad", *, B: "1/rad", C: "-", D: "N", Sx: "rad", Sy: "N") -> "N":
    with open({count!r}, "ab") as file:
        file.write(b".")
    return Sy - B * D * (alpha - Sx)
'''
EXACT = "alpha,Fy\n" + "".join(f"{x / 128},{-16 * x}\n" for x in range(-20, 21))
LINE = '''"""A line, which the data lie on."""

def line(alpha: "rad", *, D: "N", B: "N") -> "N":
    return B + D * alpha
'''


@pytest.mark.slow
@pytest.mark.fault(
    row="R25",
    fault="result deleted, all evaluations rejected, data without error, bad seed, "
    "hang-up, server of workers killed",
    promise="each noticed in words and in the exit code; partial results kept",
)
def test_silence(tmp_path: Path, measured: Figures) -> None:
    """Six faults, each of which must be noticed in words and in the exit code."""
    prepare()
    noticed = {
        "deleted result": _deleted(tmp_path),
        "all rejected": _rejected(tmp_path),
        "no error in the data": _exact(tmp_path),
        "a bad seed": _bad_seed(tmp_path),
        "hang-up": _hang_up(tmp_path),
        "server killed": _server_killed(),
    }
    unseen = [what for what, seen in noticed.items() if not seen]
    measured(
        f"{len(noticed) - len(unseen)} of {len(noticed)} noticed"
        + f"; not: {', '.join(unseen)}" * bool(unseen)
    )
    assert not unseen


def _deleted(folder: Path) -> bool:
    root = folder / "deleted"
    sweep = ("-m", *TINY, "seed=0,1", f"root={root}")
    identified(*sweep)
    next(root.glob("*/*/*/result.json")).unlink()
    checked = [check.message for check in result_checks(root, quarantine=False)]
    again = identified(*sweep)
    seen = any("1 of 2 runs" in line for line in checked) and "have no result.json" in again.err
    return seen and again.code == 0 and len(list(root.glob("*/*/*/result.json"))) == 2


def _rejected(folder: Path) -> bool:
    model, root = folder / "never.py", folder / "rejected"
    model.write_text(NEVER, encoding="utf-8")
    ended = identified("-m", *TINY, "model=function", f"model.path={model}", f"root={root}")
    partials = list(root.glob("*/*/*/partial.json"))
    seen = "no evaluation gave a value" in ended.out and "gone" in ended.out
    return seen and ended.code == 3 and len(partials) == 1 and not list(root.rglob("result.json"))


def _exact(folder: Path) -> bool:
    data, model, root = folder / "exact.csv", folder / "line.py", folder / "exact"
    data.write_text(EXACT, encoding="utf-8")
    model.write_text(LINE, encoding="utf-8")
    space = "+space={D: {unit: N, low: -5000, high: 5000}, B: {unit: N, low: -100, high: 100}}"
    ended = identified(
        "model=function", f"model.path={model}", "dataset=csv", f"dataset.path={data}",
        "~space", space, "optimizer=least_squares", f"root={root}",
    )  # fmt: skip
    return ended.code == 0 and "Traceback" not in ended.err


def _bad_seed(folder: Path) -> bool:
    ended = identified("-m", *TINY, "seed=1,2,-3", f"root={folder / 'seeds'}")
    return ended.code == 2 and "seed: is -3" in ended.complaint


def _hang_up(folder: Path) -> bool:
    root, model, count = folder / "hang_up", folder / "counted.py", folder / "count"
    model.write_text(COUNTED.format(count=str(count)), encoding="utf-8")
    sweep = begun(Call([
        "-m", *TINY, "budget.evaluations=null", "budget.seconds=60", "seed=0,1", f"root={root}",
        "model=function", f"model.path={model}",
    ]))  # fmt: skip
    until = time.monotonic() + 120
    while time.monotonic() < until:  # to be tried it is evaluated now and then before the run
        if count.exists() and count.stat().st_size > 1000:
            break
        time.sleep(0.05)
    os.kill(sweep.pid, signal.SIGHUP)
    ended = sweep.end()
    partials = [json.loads(path.read_bytes()) for path in root.glob("*/*/*/partial.json")]
    seen = "interrupted" in ended.out and ended.code == 128 + signal.SIGHUP
    return seen and len(partials) == 1 and len(partials[0]["curve"]["loss"]) > 0


def _server_killed() -> bool:
    """Killed between two jobs, so that the next worker is asked of a server that is gone."""
    workers: Workers[int, int] = Workers(abs, 2, 30.0, ("experiments.app.runs",))
    with workers:
        server = forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]
        os.kill(server, signal.SIGKILL)
        workers.start(-3)
        ended = workers.wait(30.0) or workers.wait(30.0) or workers.wait(30.0)
        return [one.result for one in ended] == [3]
