"""The runs of a root, distinguished by everything except their seed, and their origins."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

import pandas as pd

from miho.analysis.text import significant
from miho.analysis.variants import named_apart, with_names_of
from miho.study import Runs
from miho.study.files import CONFIG, ENVIRONMENT, DamagedRun, read_checked
from miho.study.provenance import flattened

Settings = Mapping[str, str]

MANY = 6
"""Largest number of different values that are listed separately."""


@dataclass(frozen=True)
class Origin:
    """Request and environment of a run; runs that differ only in seed share `config`.

    Keys of `config` and `environment` are dotted paths, values are JSON texts.
    """

    code: str
    data: str
    config: Settings
    environment: Settings


def read_origins(
    folders: Iterable[str], progress: Callable[[], None] = lambda: None
) -> tuple[dict[str, Origin], dict[str, str]]:
    """The origins of run folders, and the reasons why damaged folders were skipped.

    Curves are not read. `progress` is called after every folder.
    """
    origins, damaged = {}, {}
    configs: dict[str, Settings] = {}
    for folder in folders:
        try:
            origins[folder] = _origin(folder, configs)
        except DamagedRun as damage:
            damaged[folder] = str(damage)
        except (ValueError, LookupError, AttributeError, RecursionError) as bad:
            damaged[folder] = f"{folder}: {type(bad).__name__}: {bad}"
        progress()
    return origins, damaged


def _origin(folder: str, configs: dict[str, Settings]) -> Origin:
    result, texts = read_checked(folder)
    digest = result["files"][CONFIG]
    if digest not in configs:
        configs[digest] = json_leaves(json.loads(texts[CONFIG]))
    environment = json_leaves(json.loads(texts[ENVIRONMENT]))
    return Origin(str(result["code"]), str(result["data"]), configs[digest], environment)


def json_leaves(tree: Mapping[str, Any]) -> dict[str, str]:
    """Leaves of nested mappings: dotted path to JSON text."""
    return {path: json.dumps(leaf, ensure_ascii=False) for path, leaf in flattened(tree).items()}


def plain(text: str) -> str:
    """A JSON text without the quotes of strings."""
    return text[1:-1] if text.startswith('"') else text


def environment_table(origins: Iterable[Origin]) -> pd.DataFrame:
    """Environments of the runs: what, value, runs; a row for each value that differs between runs.

    More than MANY values are given as a range; time and load (of one minute) always are.
    """
    environments = [origin.environment for origin in origins]
    keys = dict.fromkeys(key for environment in environments for key in environment)
    rows: list[dict[str, object]] = []
    for key in keys:
        values = [plain(environment[key]) for environment in environments if key in environment]
        counts = pd.Series(values).value_counts()
        times = {str(value): int(count) for value, count in counts.items()}
        if key in ("time", "load") or len(times) > MANY:
            times = {_range(values): len(values)}
        rows += [{"what": key, "value": value, "runs": count} for value, count in times.items()]
    return pd.DataFrame(rows, columns=["what", "value", "runs"])


def _range(values: list[str]) -> str:
    """First to last, in numerical order if all are numbers; lists by their first number."""
    firsts = [value.strip("[]").partition(",")[0] for value in values]
    try:
        ordered = [significant(value, 4) for value in sorted(map(float, firsts))]
    except ValueError:
        ordered = sorted(values)
    return ordered[0] if ordered[0] == ordered[-1] else f"{ordered[0]} to {ordered[-1]}"


FINITE = ("seed", "evaluations", "seconds", "dimension")
WORDS = ("problem", "optimizer", "outcome")
MALFORMED = "has a value of the wrong type"


@dataclass(frozen=True, eq=False)
class Sweep:
    """Runs and curves as in `miho.load_runs`, with names that distinguish all problems and methods.

    `origins` are by the runs' folders. `damaged` lists the folders that were skipped, with the
    reason.
    """

    runs: pd.DataFrame
    curves: pd.DataFrame
    damaged: pd.DataFrame
    origins: Mapping[str, Origin]

    @classmethod
    def of(cls, stored: Runs, progress: Callable[[], None] = lambda: None) -> Sweep:
        """The contents of a root; `progress` is called after every folder."""
        curves, runs, damaged = stored.curves, stored.runs, stored.damaged
        origins, broken = read_origins(runs["folder"], progress)
        broken |= dict.fromkeys(_malformed(runs), MALFORMED)
        if broken:
            runs = runs[~runs["folder"].isin(broken)]
            curves = curves[curves["id"].isin(runs["id"])]
            rows = {"folder": list(broken), "reason": list(broken.values())}
            damaged = pd.concat([damaged, pd.DataFrame(rows)], ignore_index=True)
        origins = {folder: origins[folder] for folder in runs["folder"]}
        runs = runs.assign(unit=runs["unit"].fillna("-"))
        runs = named_apart(runs)
        curves = with_names_of(curves, runs)
        return cls(runs.reset_index(drop=True), curves.reset_index(drop=True), damaged, origins)


def _malformed(runs: pd.DataFrame) -> list[str]:
    """Folders of runs with words in place of numbers, or the reverse.

    Only the error of a run without a finite value may be NaN.
    """
    right = runs["error"].map(lambda value: isinstance(value, Real)).astype(bool)
    for column in FINITE:
        right &= runs[column].map(lambda v: isinstance(v, Real) and math.isfinite(v)).astype(bool)
    for column in WORDS:
        right &= runs[column].map(lambda value: isinstance(value, str)).astype(bool)
    return [str(folder) for folder in runs["folder"][~right]]
