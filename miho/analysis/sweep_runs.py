"""The runs of a root, told apart: what differs in more than the seed has another name."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real

import pandas as pd

from miho.analysis.sweep_origins import Origin, Settings, plain, read_origins
from miho.study import Runs

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
    def of(cls, found: Runs, each: Callable[[], None] = lambda: None) -> Sweep:
        """What a root holds; `each` is called after every folder read."""
        curves, runs, damaged = found.curves, found.runs, found.damaged
        origins, broken = read_origins(runs["folder"], each)
        broken |= dict.fromkeys(_malformed(runs), MALFORMED)
        if broken:
            runs = runs[~runs["folder"].isin(broken)]
            curves = curves[curves["id"].isin(runs["id"])]
            rows = {"folder": list(broken), "reason": list(broken.values())}
            damaged = pd.concat([damaged, pd.DataFrame(rows)], ignore_index=True)
        origins = {folder: origins[folder] for folder in runs["folder"]}
        runs = named(runs.assign(unit=runs["unit"].fillna("-")), list(origins.values()))
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


def named(runs: pd.DataFrame, origins: Sequence[Origin]) -> pd.DataFrame:
    """`runs` with what differs under one name added to `problem` and to `optimizer`.

    Runs are of one problem if they have the same data, model and loss, and of one method if all
    else but the seed is the same as well, code included.
    """
    seeds = [str(seed) for seed in runs["seed"]]
    names = [str(name) for name in runs["problem"]]
    asked = [_under(origin.config, OF_PROBLEM) for origin in origins]
    kinds = [(origin.data, _same(each)) for origin, each in zip(origins, asked, strict=True)]
    told = [
        {**each, **_under(origin.config, ("dataset",)), "data": origin.data[:DIGEST]}
        for origin, each in zip(origins, asked, strict=True)
    ]
    problems = _labels(names, names, kinds, told, seeds)

    names = [str(name) for name in runs["optimizer"]]
    rest = [
        {**_outside(origin.config, OF_PROBLEM), "code": origin.code[:DIGEST]} for origin in origins
    ]
    within = list(zip(problems, names, strict=True))
    methods = _labels(names, within, [_same(each) for each in rest], rest, seeds)
    return runs.assign(problem=problems, optimizer=methods)


def _under(config: Settings, groups: Collection[str]) -> dict[str, str]:
    """The settings inside these groups of the configuration."""
    return {key: value for key, value in config.items() if key.partition(".")[0] in groups}


def _outside(config: Settings, groups: Collection[str]) -> dict[str, str]:
    return {key: value for key, value in config.items() if key.partition(".")[0] not in groups}


def _same(settings: Settings) -> Hashable:
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
        found = _varying([settings[row] for row in rows], [seeds[row] for row in rows])
        varying.setdefault(names[rows[0]], {}).update(dict.fromkeys(found))
    return [
        _label(name, list(varying[name]), chosen)
        for name, chosen in zip(names, settings, strict=True)
    ]


def _varying(settings: Sequence[Settings], seeds: Sequence[str]) -> list[str]:
    keys = dict.fromkeys(key for one in settings for key in one)
    found = []
    for key in keys:
        values = [one.get(key) for one in settings]
        if len(set(values)) > 1 and values != list(seeds):
            found.append(key)
    return found


def _label(name: str, keys: Sequence[str], settings: Settings) -> str:
    lasts = [key.rpartition(".")[2] for key in keys]
    parts = [
        f"{last if lasts.count(last) == 1 else key}={plain(settings.get(key, '-'))[-LONGEST:]}"
        for key, last in zip(keys, lasts, strict=True)
    ]
    return f"{name} {', '.join(parts)}" if parts else name
