"""Where the runs of a root come from: configuration, versions, machine and digests of each."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from miho.study.files import CONFIG, ENVIRONMENT, DamagedRun, read_checked

Settings = Mapping[str, str]

MANY = 6
"""More different values than this are not told one by one."""


@dataclass(frozen=True)
class Origin:
    """What one run was asked and what it ran on; `config` is shared by runs that differ in seed.

    Keys of `config` and `environment` are dotted paths, values are JSON texts.
    """

    code: str
    data: str
    config: Settings
    environment: Settings


def read_origins(
    folders: Iterable[str], each: Callable[[], None] = lambda: None
) -> tuple[dict[str, Origin], dict[str, str]]:
    """The origin of each run folder, and of the folders that do not match their checksums why.

    Curves are not read. `each` is called after every folder.
    """
    found, damaged = {}, {}
    configs: dict[str, Settings] = {}
    for folder in folders:
        try:
            found[folder] = _origin(folder, configs)
        except DamagedRun as damage:
            damaged[folder] = str(damage)
        except (ValueError, LookupError, AttributeError, RecursionError) as bad:
            damaged[folder] = f"{folder}: {type(bad).__name__}: {bad}"
        each()
    return found, damaged


def _origin(folder: str, configs: dict[str, Settings]) -> Origin:
    result, texts = read_checked(folder)
    digest = result["files"][CONFIG]
    if digest not in configs:
        configs[digest] = flat(json.loads(texts[CONFIG]))
    environment = flat(json.loads(texts[ENVIRONMENT]))
    return Origin(str(result["code"]), str(result["data"]), configs[digest], environment)


def flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """The leaves of nested mappings: dotted path to JSON text."""
    leaves: dict[str, str] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping) and value:
            leaves |= flat(value, f"{prefix}{key}.")
        else:
            leaves[f"{prefix}{key}"] = json.dumps(value, ensure_ascii=False)
    return leaves


def plain(text: str) -> str:
    """A JSON text as a reader writes it: words without quotes."""
    return text[1:-1] if text.startswith('"') else text


def environment_table(origins: Iterable[Origin]) -> pd.DataFrame:
    """What the runs ran on: what, value, runs; a row for each value that differs between runs.

    More than MANY values are told as a range, time and load (of one minute) in any case.
    """
    environments = [origin.environment for origin in origins]
    keys = dict.fromkeys(key for environment in environments for key in environment)
    rows: list[dict[str, object]] = []
    for key in keys:
        values = [plain(environment[key]) for environment in environments if key in environment]
        counts = pd.Series(values).value_counts()
        told = {str(value): int(count) for value, count in counts.items()}
        if key in ("time", "load") or len(told) > MANY:
            told = {_range(values): len(values)}
        rows += [{"what": key, "value": value, "runs": count} for value, count in told.items()]
    return pd.DataFrame(rows, columns=["what", "value", "runs"])


def _range(values: list[str]) -> str:
    """First to last, by number where all are numbers; of lists, by their first number."""
    firsts = [value.strip("[]").partition(",")[0] for value in values]
    try:
        ordered = [f"{value:.4g}" for value in sorted(map(float, firsts))]
    except ValueError:
        ordered = sorted(values)
    return ordered[0] if ordered[0] == ordered[-1] else f"{ordered[0]} to {ordered[-1]}"
