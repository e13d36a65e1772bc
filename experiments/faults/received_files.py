"""R24: files that others wrote or that time has spoilt."""

from __future__ import annotations

import os
import signal
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from scipy.io import savemat

from experiments.export import write_csv
from experiments.faults.row import Row
from experiments.received_yaml import check_file
from miho import load_runs
from miho.data import load_csv, load_mat
from miho.models import Pacejka, load_function, load_tir, read_parameters
from miho.models.identified import Identified, UncheckedWarning, Value, parameters_text
from miho.optim import Budget, RandomSearch, minimize
from miho.study import Identity, Store, execute
from miho.testing import DecayFit

FLIPS, WAIT = 1000, 2.0
COLUMNS, UNITS = ("alpha", "Fy"), ("rad", "N")
FORMULAS = ("=1+1", "+1+1", "-1+1", "@SUM(1)")


def received_files(folder: Path) -> Row:
    """Flip bits, name devices, read what expands, and export what a table would calculate."""
    crashed, wrong = _mat_flips(folder, packed=True)
    crashed += _mat_flips(folder, packed=False)[0]
    unseen = _parameters_flips(folder)
    slow = [name for name, read in _devices(folder).items() if not _refused(read)]
    bombs = [name for name, read in _yaml(folder).items() if not _refused(read)]
    cells = _formulas(folder)
    return Row(
        "R24",
        f"{FLIPS} bit flips of a .mat, packed and not, and of parameters.json; pipes and devices "
        "as files; YAML of 9^7 aliases, 3,000 deep, holding itself; CSV export of formulas",
        f"no crash, nothing above {WAIT:g} s, no wrong number, one line, no formula",
        f".mat: {crashed} crashes, {wrong} wrong numbers; parameters.json: {unseen} wrong numbers; "
        f"not refused in time: {', '.join([*slow, *bombs]) or 'none'}; {cells} formulas exported",
        not (crashed or wrong or unseen or slow or bombs or cells),
    )


def _mat_flips(folder: Path, *, packed: bool) -> tuple[int, int]:
    """How many flips of a file end the process, and how many give other numbers.

    Nothing but a compressed file's own checksum can see a flip in a number.
    """
    path = folder / "good.mat"
    data = {"alpha": np.linspace(-0.2, 0.2, 41), "Fy": np.linspace(4e3, -4e3, 41)}
    savemat(path, data, do_compression=packed)
    good = path.read_bytes()
    crashed = wrong = done = 0
    while done < FLIPS:
        ours, theirs = os.pipe()
        process = os.fork()
        if not process:
            _flip(good, folder / "flipped.mat", data, done, theirs)
        os.close(theirs)
        with os.fdopen(ours, "rb") as file:
            answers = file.read()
        os.waitpid(process, 0)
        done += len(answers)
        wrong += answers.count(b"w")
        if done < FLIPS:  # the next one is what ended it
            crashed, done = crashed + 1, done + 1
    return crashed, wrong


def _flip(good: bytes, path: Path, data: dict[str, np.ndarray], first: int, pipe: int) -> None:
    """In a child: read one flipped file after the other and say how each went; does not return."""
    for number in range(first, FLIPS):
        chance = np.random.default_rng((24, number))
        flipped = bytearray(good)
        flipped[int(chance.integers(len(good)))] ^= 1 << int(chance.integers(8))
        path.write_bytes(flipped)
        answer = b"r"
        try:
            found = load_mat(str(path), COLUMNS, UNITS, "Fy")
            same = all(np.array_equal(found[name], data[name]) for name in COLUMNS)
            answer = b"s" if same else b"w"
        except ValueError:
            pass
        except BaseException:  # noqa: BLE001 -- a traceback is as bad as a crash
            os._exit(1)
        os.write(pipe, answer)
    os._exit(0)


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
    for path in map(str, (pipe, "/dev/zero")):
        found |= {
            f"csv {path}": partial(load_csv, path, COLUMNS, UNITS, "Fy"),
            f"mat {path}": partial(load_mat, path, COLUMNS, UNITS, "Fy"),
            f"tir {path}": partial(load_tir, path),
            f"parameters {path}": partial(read_parameters, path, Pacejka()),
            f"model {path}": partial(load_function, path),
        }  # fmt: skip
    return found


def _yaml(folder: Path) -> dict[str, Callable[[], object]]:
    rows = [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 8)]
    texts = {
        "aliases": "\n".join(["a0: &a0 [lol]", *rows]),
        "deep": "a: " + "[" * 3000 + "]" * 3000,
        "itself": "a: &a [*a]",
    }
    for name, text in texts.items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    return {name: partial(check_file, folder / f"{name}.yaml") for name in texts}


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
    """How many cells of exported tables begin like a formula."""
    root, out = folder / "runs", folder / "out"
    for seed, name in enumerate(FORMULAS):
        execute(
            Store(root), Identity("decay", "random", seed, {}, "c0de", "da7a"),
            lambda: minimize(RandomSearch(), DecayFit(), Budget(evaluations=20), 0),
            DecayFit.space, {"unit": name},
        )  # fmt: skip
    found = load_runs(root)
    out.mkdir()
    write_csv(found.runs, found.curves, out)
    cells = [
        cell.strip('"')
        for path in out.glob("*.csv")
        for line in path.read_text(encoding="utf-8").splitlines()
        for cell in line.split(",")
    ]
    return sum(cell.startswith(FORMULAS) for cell in cells)
