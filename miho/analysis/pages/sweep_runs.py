"""The runs of a root, distinguished by everything except their seed, and their origins."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from numbers import Real
from typing import Any

import pandas as pd

from miho.analysis.text import significant
from miho.analysis.variants import named_apart, with_names_of
from miho.study import Runs
from miho.study.provenance import flattened
from miho.study.settings import RunRequest

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

    @classmethod
    def of(cls, request: RunRequest) -> Origin:
        """The origin of a run from its stored request."""
        config = _leaves_of_parts(tuple(request.parts.items()))
        environment = json_leaves(json.loads(request.environment))
        return cls(request.code, request.data, config, environment)


def json_leaves(tree: Mapping[str, Any]) -> dict[str, str]:
    """Leaves of nested mappings: dotted path to JSON text."""
    return {path: json.dumps(leaf, ensure_ascii=False) for path, leaf in flattened(tree).items()}


@lru_cache
def _leaves_of_parts(parts: tuple[tuple[str, bytes], ...]) -> Settings:
    return json_leaves({name: json.loads(part) for name, part in parts})


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
    def of(cls, stored: Runs) -> Sweep:
        """The contents of a root."""
        curves, runs, damaged = stored.curves, stored.runs, stored.damaged
        origins, broken = {}, dict.fromkeys(_malformed(runs), MALFORMED)
        for folder, request in zip(runs["folder"], stored.requests, strict=True):
            try:
                origins[folder] = Origin.of(request)
            except (ValueError, RecursionError) as error:
                broken[folder] = f"{folder}: {type(error).__name__}: {error}"
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
    valid = runs["error"].map(lambda value: isinstance(value, Real)).astype(bool)
    for column in FINITE:
        valid &= runs[column].map(lambda v: isinstance(v, Real) and math.isfinite(v)).astype(bool)
    for column in WORDS:
        valid &= runs[column].map(lambda value: isinstance(value, str)).astype(bool)
    return [str(folder) for folder in runs["folder"][~valid]]
