"""All runs of a root as tidy tables."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pandas as pd
from numpy.typing import NDArray

from miho.study.files import CONFIG, CURVE, ENVIRONMENT, DamagedRun, NoResult, read_checked
from miho.study.settings import Parts, RunRequest, differing, parts_of

RUN_COLUMNS = [
    "id", "problem", "optimizer", "seed", "outcome", "error", "unit", "evaluations", "seconds",
    "cpu_seconds", "setup_seconds", "irreducible", "irreducible_low", "irreducible_high",
    "optimum", "dimension", "timing_valid",
    "folder",
]  # fmt: skip
KEYS = ["id", "problem", "optimizer", "seed"]
COLUMNS = ("evaluations", "seconds", "cpu_seconds", "error")
"""Columns of a curve."""
DEPTH = 3
"""Runs are in root/<problem>/<optimizer>/<id>."""


@dataclass(frozen=True)
class Damage:
    """A folder that was skipped, and the reason."""

    folder: str
    reason: str


@dataclass(frozen=True, eq=False)
class Runs:
    """The runs of a root at the time when it was read.

    Attributes
    ----------
    runs : DataFrame
        One row per finished run, by problem, method and seed, with a column for each setting that
        differs, such as `optimizer.R`. `error` is the square root of the loss in `unit`,
        `irreducible` an estimate of the smallest error of any model of the same inputs, `optimum`
        the smallest error in the space if it is known (else NaN), `dimension` the number of
        parameters and `theta.<name>` their values. `seconds` and `cpu_seconds` are of the method
        alone, without `setup_seconds` of imports and tracing; `timing_valid` says whether the
        machine was quiet enough to compare seconds.
    curves : DataFrame
        One row per improvement and one at the end of each run (a step function), with the same
        columns of settings.
    damaged : DataFrame
        Folders that were skipped, with the reason.
    top : Path
        The root.
    skipped : tuple of Damage
        Damaged runs.
    keys : DataFrame
        Identifying columns of the curves.
    """

    runs: pd.DataFrame
    top: Path
    skipped: tuple[Damage, ...]
    keys: pd.DataFrame
    texts: tuple[bytes, ...]
    """For each row of `keys`, the text of the curve, without parameters."""
    requests: tuple[RunRequest, ...]
    """For each row of `runs`, its request and environment."""

    def __repr__(self) -> str:
        """Numbers of runs, methods and problems, for interpreters."""
        runs = self.runs
        counts = {
            "run": len(runs),
            "method": runs["optimizer"].nunique(),
            "problem": runs["problem"].nunique(),
        }
        contents = ", ".join(f"{n:,} {name}{'s' * (n != 1)}" for name, n in counts.items())
        skipped = f", {len(self.skipped):,} damaged" if self.skipped else ""
        return f"<Runs in {self.top}: {contents}{skipped}; tables: runs, curves, damaged>"

    @property
    def curves(self) -> pd.DataFrame:
        """Id, problem, optimizer, seed, settings, evaluations, seconds, cpu_seconds and error."""
        return self._curves[0]

    @cached_property
    def damaged(self) -> pd.DataFrame:
        """Folder and reason of each damaged run."""
        skipped = sorted([*self.skipped, *self._curves[1]], key=lambda damage: damage.folder)
        rows = [(damage.folder, damage.reason) for damage in skipped]
        return pd.DataFrame(rows, columns=["folder", "reason"])

    @cached_property
    def _curves(self) -> tuple[pd.DataFrame, list[Damage]]:
        """The table of curves, and the malformed curves with a valid checksum."""
        malformed, rows, curves = [], [], []
        for row, text in enumerate(self.texts):
            try:
                curves.append(curve_of(text))
                rows.append(row)
            except ValueError as error:
                folder = str(self.keys["folder"].iloc[row])
                malformed.append(Damage(folder, f"{folder}: {error}"))
        keys = self.keys.drop(columns="folder").iloc[rows].reset_index(drop=True)
        lengths = [curve.shape[1] for curve in curves]
        table = keys.loc[keys.index.repeat(lengths)].reset_index(drop=True)
        joined = np.hstack([np.empty((len(COLUMNS), 0)), *curves])
        columns = dict(zip(COLUMNS, joined, strict=True))
        return table.assign(**columns), malformed


def load_runs(root: str | Path) -> Runs:
    """Read all finished runs below `root`; damaged runs are listed and skipped.

    Every file of every run is verified by its checksum, so no table contains numbers of a damaged
    run. Checksums detect damage, not forgery: a malformed `curve.json` with a valid checksum is
    listed and omitted from `curves`, but its row in `runs` remains.

    Parameters
    ----------
    root : path
        Folder of runs.

    Returns
    -------
    Runs
        Tables of the runs.

    Raises
    ------
    FileNotFoundError
        If the root does not exist.
    """
    top = Path(root)
    if not top.is_dir():
        raise FileNotFoundError(f"{top}: no such folder of runs; run something first")
    read: list[tuple[dict[str, Any], bytes, RunRequest]] = []
    skipped: list[Damage] = []
    configs: dict[str, Parts] = {}  # by the digest of their file; seeds share it
    for folder in _folders(str(top), DEPTH):
        if isinstance(folder, Damage):
            skipped.append(folder)
            continue
        try:
            result, files = read_checked(folder)
            row, request = _run_row(folder, result), _request(result, files, configs)
        except NoResult:
            continue
        except DamagedRun as error:
            skipped.append(Damage(folder, str(error)))
        except (ArithmeticError, ValueError, LookupError, TypeError, AttributeError) as error:
            skipped.append(Damage(folder, f"{folder}: {type(error).__name__}: {error}"))
        else:
            read.append((row, without_theta(files[CURVE]), request))
    # In the order of seeds, because methods are compared seed by seed.
    methods = groupby(read, lambda run: Path(run[0]["folder"]).parent)
    read = [run for _, runs in methods for run in sorted(runs, key=_seed)]
    rows, curves, requests = zip(*read, strict=True) if read else ((), (), ())
    table = pd.DataFrame(rows) if rows else pd.DataFrame(columns=RUN_COLUMNS)
    columns = differing(requests)
    table = pd.concat([table[KEYS], columns, table.drop(columns=KEYS)], axis=1)
    keys = table[[*KEYS, *columns, "folder"]]
    return Runs(table, top, tuple(skipped), keys, curves, requests)


def _seed(run: tuple[dict[str, Any], bytes, RunRequest]) -> int:
    """Seed of a run; a forged run may have another value."""
    return seed if type(seed := run[2].seed) is int else 0


def without_runs(root: str | Path) -> str:
    """The message on a root without finished runs; it names the folders in it that have some."""
    folders = sorted(folder for folder in Path(root).iterdir() if folder.is_dir())
    holding = [str(folder) for folder in folders if len(load_runs(folder).runs)]
    remedy = f"give {' or '.join(holding)}" if holding else "run python -m experiments.identify"
    return f"{root}: holds no finished run; {remedy}"


def _folders(top: str, depth: int) -> Iterator[str | Damage]:
    """Folders `depth` levels below `top` in the order of their paths, and obstacles on the way.

    Hidden folders are skipped. Links to folders are not followed, because they can lead out of the
    root; they count as damage, and so do unreadable folders.
    """
    if depth == 0:
        yield top
        return
    try:
        with os.scandir(top) as entries:
            inside = [entry for entry in entries if not entry.name.startswith(".")]
        for entry in sorted(inside, key=lambda entry: f"{entry.name}/"):
            if entry.is_dir(follow_symlinks=False):
                yield from _folders(entry.path, depth - 1)
            elif entry.is_dir():
                yield Damage(entry.path, f"{entry.path}: a symbolic link, which is not followed")
    except OSError as error:
        yield Damage(top, f"{top}: {error.strerror}")


def _request(
    result: Mapping[str, Any], files: Mapping[str, bytes], configs: dict[str, Parts]
) -> RunRequest:
    digest = str(result["files"][CONFIG])
    if digest not in configs:
        configs[digest] = parts_of(files[CONFIG])
    names = str(result["problem"]), str(result["optimizer"]), result["seed"]
    origin = str(result["code"]), str(result["data"]), files[ENVIRONMENT]
    return RunRequest(*names, configs[digest], *origin)


def _run_row(folder: str, result: Mapping[str, Any]) -> dict[str, Any]:
    facts: Mapping[str, Any] = result["facts"]
    names = _theta_names(*(parameter["name"] for parameter in result["parameters"]))
    theta = result["theta"] or [math.nan] * len(names)
    row = {name: result[name] for name in RUN_COLUMNS if name in result}
    row |= {name: facts.get(name, math.nan) for name in RUN_COLUMNS if "irreducible" in name}
    row |= {
        "error": error_of(result["loss"]),
        "unit": facts.get("unit"),
        "optimum": error_of(facts.get("optimum")),
        "dimension": len(names),
        "timing_valid": facts.get("timing_valid"),
        "folder": folder,
    }
    thetas = zip(names, theta, strict=True)
    return {name: row[name] for name in RUN_COLUMNS} | dict(thetas)


@lru_cache
def _theta_names(*parameters: str) -> list[str]:
    return [f"theta.{name}" for name in parameters]


def curve_of(text: bytes) -> NDArray[np.float64]:
    """The curve in a JSON text: rows `COLUMNS`, a column for each improvement and one for the end.

    Raises ValueError for a text without a curve.
    """
    try:
        values = orjson.loads(text)
        rows = [*(values[name] for name in COLUMNS[:-1]), list(map(error_of, values["loss"]))]
        curve = np.array(rows)
    except (ValueError, LookupError, TypeError, OverflowError) as error:
        raise ValueError(f"contains no curve: {type(error).__name__}: {error}") from None
    if curve.ndim != 2 or curve.dtype.kind not in "iuf":
        raise ValueError("contains no curve: its columns are not lists of numbers")
    if not np.isfinite(curve[:-1]).all():
        raise ValueError("contains no curve: its evaluations or seconds are not finite")
    return curve.astype(float)


def error_of(loss: float | None) -> float:
    """The error of a loss: its square root, or NaN without a loss."""
    return math.nan if loss is None or loss < 0 else math.sqrt(loss)


def without_theta(curve: bytes) -> bytes:
    """A `curve.json` without its parameters, which are most of it; its keys are sorted."""
    end = curve.find(b',"theta":')
    return curve if end < 0 else curve[:end] + b"}"
