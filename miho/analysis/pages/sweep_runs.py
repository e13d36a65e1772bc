"""The runs of a root: told apart by all but their seed, with where each of them comes from."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import pandas as pd

from miho.analysis.text import significant
from miho.study import Runs
from miho.study.files import CONFIG, ENVIRONMENT, DamagedRun, read_checked
from miho.study.provenance import flattened

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
    folders: Iterable[str], progress: Callable[[], None] = lambda: None
) -> tuple[dict[str, Origin], dict[str, str]]:
    """The origin of each run folder, and of the folders that do not match their checksums why.

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
    """The leaves of nested mappings: dotted path to JSON text."""
    return {path: json.dumps(leaf, ensure_ascii=False) for path, leaf in flattened(tree).items()}


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
        times = {str(value): int(count) for value, count in counts.items()}
        if key in ("time", "load") or len(times) > MANY:
            times = {_range(values): len(values)}
        rows += [{"what": key, "value": value, "runs": count} for value, count in times.items()]
    return pd.DataFrame(rows, columns=["what", "value", "runs"])


def _range(values: list[str]) -> str:
    """First to last, by number where all are numbers; of lists, by their first number."""
    firsts = [value.strip("[]").partition(",")[0] for value in values]
    try:
        ordered = [significant(value, 4) for value in sorted(map(float, firsts))]
    except ValueError:
        ordered = sorted(values)
    return ordered[0] if ordered[0] == ordered[-1] else f"{ordered[0]} to {ordered[-1]}"


OF_PROBLEM = ("model", "loss")
FINITE = ("seed", "evaluations", "seconds", "dimension")
WORDS = ("problem", "optimizer", "outcome")
MALFORMED = "holds something else where a number or a word belongs"
DIGEST = 6
"""Hexadecimal digits of a digest that tell names apart."""
LONGEST = 40
"""Of a value so many characters are told, the last ones: paths differ at their ends."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """`runs` and `curves` as in `miho.load_runs`, with names in `problem` and `optimizer` that
    tell everything apart that must not share a curve; `origins` by the runs' folders.

    `damaged` lists the folders that were skipped, with the reason.
    """

    runs: pd.DataFrame
    curves: pd.DataFrame
    damaged: pd.DataFrame
    origins: Mapping[str, Origin]

    @classmethod
    def of(cls, stored: Runs, progress: Callable[[], None] = lambda: None) -> Sweep:
        """What a root holds; `progress` is called after every folder read."""
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
        runs = with_distinct_names(runs, list(origins.values()))
        names = runs.set_index("id")
        curves = curves.assign(
            **{name: curves["id"].map(names[name]) for name in ("problem", "optimizer")}
        )
        return cls(runs.reset_index(drop=True), curves.reset_index(drop=True), damaged, origins)


def _malformed(runs: pd.DataFrame) -> list[str]:
    """The folders of runs that hold words for numbers, or the other way round.

    Only the error of a run that saw no finite value may be NaN.
    """
    right = runs["error"].map(lambda value: isinstance(value, Real)).astype(bool)
    for column in FINITE:
        right &= runs[column].map(lambda v: isinstance(v, Real) and math.isfinite(v)).astype(bool)
    for column in WORDS:
        right &= runs[column].map(lambda value: isinstance(value, str)).astype(bool)
    return [str(folder) for folder in runs["folder"][~right]]


def with_distinct_names(runs: pd.DataFrame, origins: Sequence[Origin]) -> pd.DataFrame:
    """`runs` with what differs under one name added to `problem` and to `optimizer`.

    Runs are of one problem if they have the same data, model and loss, and of one method if all
    else but the seed is the same as well, code included.
    """
    seeds = [str(seed) for seed in runs["seed"]]
    names = [str(name) for name in runs["problem"]]
    of_problem = [_under(origin.config, OF_PROBLEM) for origin in origins]
    kinds = [
        (origin.data, _key(settings)) for origin, settings in zip(origins, of_problem, strict=True)
    ]
    described = [
        {**settings, **_under(origin.config, ("dataset",)), "data": origin.data[:DIGEST]}
        for origin, settings in zip(origins, of_problem, strict=True)
    ]
    problems = _labels(names, names, kinds, described, seeds)

    names = [str(name) for name in runs["optimizer"]]
    other_settings = [
        {**_outside(origin.config, OF_PROBLEM), "code": origin.code[:DIGEST]} for origin in origins
    ]
    within = list(zip(problems, names, strict=True))
    keys = [_key(settings) for settings in other_settings]
    methods = _labels(names, within, keys, other_settings, seeds)
    return runs.assign(problem=problems, optimizer=methods)


def _under(config: Settings, groups: Collection[str]) -> dict[str, str]:
    """The settings inside these groups of the configuration."""
    return {key: value for key, value in config.items() if key.partition(".")[0] in groups}


def _outside(config: Settings, groups: Collection[str]) -> dict[str, str]:
    return {key: value for key, value in config.items() if key.partition(".")[0] not in groups}


def _key(settings: Settings) -> Hashable:
    return frozenset(settings.items())


def _labels(
    names: Sequence[str],
    within: Sequence[Hashable],
    kinds: Sequence[Hashable],
    settings: Sequence[Settings],
    seeds: Sequence[str],
) -> list[str]:
    """Each run's name, followed by the settings that vary between runs of equal `within`.

    Runs of equal `kinds` are the same but for their seed; `settings` are what may be told of them.
    What varies for one of the runs of a name is told of all of them. What follows the seed does not
    count.
    """
    groups: dict[Hashable, dict[Hashable, int]] = {}
    for row, (group, kind) in enumerate(zip(within, kinds, strict=True)):
        groups.setdefault(group, {}).setdefault(kind, row)
    varying: dict[str, dict[str, None]] = {}
    for firsts in groups.values():
        rows = list(firsts.values())
        keys = _varying([settings[row] for row in rows], [seeds[row] for row in rows])
        varying.setdefault(names[rows[0]], {}).update(dict.fromkeys(keys))
    return [
        _label(name, list(varying[name]), values)
        for name, values in zip(names, settings, strict=True)
    ]


def _varying(settings: Sequence[Settings], seeds: Sequence[str]) -> list[str]:
    keys = dict.fromkeys(key for mapping in settings for key in mapping)
    varying = []
    for key in keys:
        values = [mapping.get(key) for mapping in settings]
        if len(set(values)) > 1 and values != list(seeds):
            varying.append(key)
    return varying


def _label(name: str, keys: Sequence[str], settings: Settings) -> str:
    lasts = [key.rpartition(".")[2] for key in keys]
    parts = [
        f"{last if lasts.count(last) == 1 else key}={plain(settings.get(key, '-'))[-LONGEST:]}"
        for key, last in zip(keys, lasts, strict=True)
    ]
    return f"{name} {', '.join(parts)}" if parts else name
