"""R24: files that others wrote or that time has spoilt."""

from __future__ import annotations

import os
import signal
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from experiments.app.console import BAD_INPUT
from miho import load_runs
from miho.analysis.text import csv_text
from miho.data import load_csv, load_mat
from miho.models import load_function, read_parameters
from miho.models.identified import Identified, UncheckedWarning, Value, parameters_text
from miho.optim import Budget, RandomSearch, minimize
from miho.study import Identity, Store, execute
from miho.testing import DecayFit
from miho.vehicle.models import Pacejka, load_tir
from tests.faults.commands import identified, prepare
from tests.faults.conftest import Figures
from tests.faults.hostile_files import flip_bits

FLIPS, WAIT = 1000, 2.0
COLUMNS, UNITS = ("alpha", "Fy"), ("rad", "N")
FORMULAS = ("=1+1", "+1+1", "-1+1", "@SUM(1)")


@pytest.mark.slow
@pytest.mark.fault(
    row="R24",
    fault=f"{FLIPS} bit flips of .mat files, packed and not, and of parameters.json; pipes and "
    "devices as files; YAML of 9^7 aliases, 3,000 deep, holding itself; formulas in CSV",
    promise=f"no crash, nothing above {WAIT:g} s, no wrong number, one line, no formula",
)
def test_received_files(tmp_path: Path, measured: Figures) -> None:
    """Flip bits, name devices, read what expands, and write names that a table would calculate."""
    prepare()
    ends, slowest = flip_bits(tmp_path, FLIPS)
    harmless = ends["refused"] + ends["as it was"]
    unseen = _parameters_flips(tmp_path)
    slow = [name for name, read in _devices(tmp_path).items() if not _refused(read)]
    bombs = [name for name in _bombs(tmp_path) if not _refused_by_the_command(tmp_path, name)]
    cells = _formulas(tmp_path)
    measured(
        f".mat: {harmless} of {ends.total()} flips refused or harmless, the slowest in "
        f"{slowest:.2f} s; parameters.json: {unseen} wrong numbers; "
        f"not refused in time: {', '.join([*slow, *bombs]) or 'none'}; {cells} formulas in CSV"
    )
    assert harmless == ends.total() >= FLIPS
    assert slowest < WAIT
    assert not (unseen or slow or bombs or cells)


def _parameters_flips(folder: Path) -> int:
    """How many flips of parameters.json give other numbers without an error."""
    model, rng, path = Pacejka(), np.random.default_rng(24), folder / "parameters.json"
    values = {
        name: Value(1.25 + k, unit, 0.01) for k, (name, unit) in enumerate(model.parameters.items())
    }
    known = Identified(
        model, values, np.eye(len(values)), dict.fromkeys(model.inputs, (-0.2, 0.2)), {}, {}
    )
    good = parameters_text(known, {}).encode()
    wrong = 0
    for position in rng.integers(len(good), size=FLIPS).tolist():
        flipped = bytearray(good)
        flipped[position] ^= 1 << int(rng.integers(8))
        path.write_bytes(flipped)
        try:
            warnings.simplefilter("error", UncheckedWarning)
            wrong += read_parameters(path, model).theta.tolist() != known.theta.tolist()
        except (ValueError, UncheckedWarning):
            continue
    return wrong


def _devices(folder: Path) -> dict[str, Callable[[], object]]:
    pipe = folder / "pipe"
    os.mkfifo(pipe)
    found: dict[str, Callable[[], object]] = {}
    for path in map(str, (pipe, "/dev/zero", "/proc/kmsg")):
        found |= {
            f"csv {path}": partial(load_csv, path, COLUMNS, UNITS, "Fy"),
            f"mat {path}": partial(load_mat, path, COLUMNS, UNITS, "Fy"),
            f"tir {path}": partial(load_tir, path),
            f"parameters {path}": partial(read_parameters, path, Pacejka()),
            f"model {path}": partial(load_function, path),
        }  # fmt: skip
    return found


def _bombs(folder: Path) -> list[str]:
    """Names of experiments, each in a folder of options of its own, that no memory holds."""
    rows = [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 8)]
    texts = {
        "aliases": "\n".join(["a0: &a0 [lol]", *rows]),
        "deep": "a: " + "[" * 3000 + "]" * 3000,
        "itself": "a: &a [*a]",
    }
    for name, text in texts.items():
        options = folder / name / "experiment"
        options.mkdir(parents=True)
        (options / f"{name}.yaml").write_text(f"# @package _global_\n{text}\n", encoding="utf-8")
    return list(texts)


def _refused_by_the_command(folder: Path, name: str) -> bool:
    """Whether `identify --config-dir` refuses an experiment by one line, in time."""
    began = time.monotonic()
    ended = identified(f"--config-dir={folder / name}", f"experiment={name}")
    lines = ended.err.splitlines()
    named = len(lines) == 1 and lines[0].startswith("error: ") and f"{name}.yaml" in lines[0]
    return named and ended.code == BAD_INPUT and time.monotonic() - began < WAIT


def _refused(read: Callable[[], object]) -> bool:
    """Whether it is refused by an error of one line, in time."""
    process = os.fork()
    if not process:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, WAIT)
        code = 1
        try:
            read()
        except (ValueError, OSError) as error:
            code = "\n" in str(error)
        finally:
            os._exit(int(code))
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 0


def _formulas(folder: Path) -> int:
    """How many cells of tables in CSV begin like a formula."""
    root = folder / "runs"
    for seed, name in enumerate(FORMULAS):
        execute(
            Store(root), Identity("decay", "random", seed, {}, "c0de", "da7a"),
            lambda: minimize(RandomSearch(), DecayFit(), Budget(evaluations=20), 0),
            DecayFit.space, {"unit": name},
        )  # fmt: skip
    stored = load_runs(root)
    cells = [
        cell.strip('"')
        for table in (stored.runs, stored.curves)
        for line in csv_text(table).splitlines()
        for cell in line.split(",")
    ]
    return sum(cell.startswith(FORMULAS) for cell in cells)
