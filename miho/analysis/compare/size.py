"""The size of a comparison, from the stored configurations of its runs."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import pandas as pd

from miho.analysis.variants import OF_PROBLEM, base_name, named_apart, setting_columns, shown
from miho.study import DamagedRun, read_run
from miho.study.manifest import first_names
from miho.study.provenance import flattened

Settings = Mapping[str, Any]
"""Settings of a run by dotted path, for example `optimizer.R`."""
Methods = Literal["paper"] | Collection[str]
"""The paper's methods, or some by name."""

MIHO = "miho"
_TIRE = {"dataset.n": 3000, "dimension": 5}
_SWARM = {
    "optimizer.c1": 2.0,
    "optimizer.c2": 2.0,
    "optimizer.inertia_start": 0.9,
    "optimizer.inertia_end": 0.4,
    "optimizer.iterations": 1000,
}
PAPER: Mapping[str, Settings] = MappingProxyType(
    {
        MIHO: _TIRE
        | {
            "optimizer.R": 10_000,
            "optimizer.eta": 5,
            "optimizer.rounding": "ceil",
            "optimizer.sampling": "normal",
            "optimizer.annealing": "linear",
            "optimizer.clip": "box",
            "optimizer.proposal": "mutation",
        },
        "gbo_small": _TIRE | {"optimizer.learning_rate": 5e-12},
        "gbo_large": _TIRE | {"optimizer.learning_rate": 1e-10},
        "pso_100": _TIRE | _SWARM | {"optimizer.particles": 100},
        "pso_500": _TIRE | _SWARM | {"optimizer.particles": 500},
    }
)
"""The methods of Sec. V-A.3 at the size of the paper's claims: rows, parameters and settings.

The paper does not print inertia and iterations of the swarms, nor MIHO's settings other than R and
eta. They are taken from `conf/optimizer`, so that no claim is judged by a modified method.
"""
NAMES = MappingProxyType({"dataset.n": "rows", "dimension": "parameters"})
OPTUNA = "optuna_hyperband"
PAPER_METHODS = (*PAPER, OPTUNA)
"""The paper's five methods, and the Hyperband of a library."""


def chosen(present: Collection[str], methods: Methods) -> list[str]:
    """The `present` methods that "paper" or a list of names selects.

    A name selects the method with all its settings. "paper" selects the PAPER_METHODS that are
    present. Raises ValueError for a name without runs.
    """
    names = set(PAPER_METHODS if methods == "paper" else methods)
    available = {*present, *map(base_name, present)}
    unknown = sorted(names - available)
    if (unknown and methods != "paper") or not available & names:
        raise ValueError(
            f"methods: there are no runs of {', '.join(unknown)}; "
            f"expected paper or some of {', '.join(sorted(available))}"
        )
    return [name for name in present if name in names or base_name(name) in names]


def settings_by_method(runs: pd.DataFrame) -> dict[str, Settings]:
    """The settings of each method of `runs`, read from the folder of its first run.

    Empty if the table has no folder or no run can be read.
    """
    settings: dict[str, Settings] = {}
    for method, first in runs.drop_duplicates("optimizer").set_index("optimizer").iterrows():
        try:
            stored = flattened(read_run(Path(first["folder"])).config)
        except (DamagedRun, LookupError, TypeError, AttributeError):
            settings[str(method)] = {}
            continue
        settings[str(method)] = stored | {"dimension": first.get("dimension")}
    return settings


def deviations(method: str, settings: Settings) -> dict[str, tuple[Any, Any]]:
    """Name, value and the paper's value of each setting that differs from the paper."""
    expected = PAPER.get(base_name(method), {})
    return {
        NAMES.get(path, path.rpartition(".")[2]): (settings.get(path), value)
        for path, value in expected.items()
        if settings.get(path) != value
    }


def mismatch(settings: Mapping[str, Settings], *methods: str) -> str:
    """Differences of these methods from the paper, such as "R = 300, the claim is for R = 10,000".

    Empty if there are none, and for methods that the paper does not have.
    """
    parts: dict[str, None] = {}
    for method in methods:
        if method in PAPER and not settings.get(method):
            return "the settings of these runs are not known"
        for name, (value, expected) in deviations(method, settings.get(method, {})).items():
            claim = f"the claim is for {name} = {in_words(expected)}"
            parts[f"{name} = {in_words(value)}, {claim}"] = None
    return "; ".join(parts)


def nearest_to_paper(runs: pd.DataFrame, settings: Mapping[str, Settings]) -> dict[str, str]:
    """For each method of the paper, the name of the runs with the nearest settings.

    Of several with equally many deviations the last counts, in the order of names.
    """
    nearest: dict[str, str] = {}
    for name in sorted(map(str, runs["optimizer"].unique()), key=lambda name: (len(name), name)):
        base = base_name(name)
        if base not in PAPER:
            continue
        count = len(deviations(name, settings.get(name, {})))
        if base not in nearest or count <= len(deviations(base, settings.get(nearest[base], {}))):
            nearest[base] = name
    return nearest


def in_words(value: Any) -> str:
    """A setting with thousands separators."""
    return f"{value:,}" if type(value) is int else shown(value)


def size_note(runs: pd.DataFrame) -> str:
    """The size of a comparison as a phrase, from the stored configurations of its runs.

    For example "R = 2,000, eta = 5, 5 repetitions (seeds 0 to 4), at most 4 s per run". R and eta
    are settings of MIHO; if they differ among its runs, the names of the methods contain them. A
    limit that differs among methods is followed by their names. Settings of model, loss or data
    that differ are named.
    """
    runs = named_apart(runs, of_problem=())
    settings = settings_by_method(runs)
    parts = []
    for path in ("optimizer.R", "optimizer.eta"):
        values = {s.get(path) for name, s in settings.items() if base_name(name) == MIHO}
        if len(values) == 1 and values != {None}:
            parts.append(f"{path.rpartition('.')[2]} = {in_words(values.pop())}")
    counts = runs.groupby("optimizer")["seed"].nunique()
    fewest, most = int(counts.min()), int(counts.max())
    several = f"{most}" if fewest == most else f"{fewest} to {most}"
    parts.append(f"{several} repetition{'s' * (most > 1)} ({_seeds(runs['seed'])})")
    for path, unit in (("budget.seconds", "s"), ("budget.evaluations", "evaluations")):
        by_limit: dict[Any, list[str]] = {}
        for name, of_method in settings.items():
            by_limit.setdefault(of_method.get(path), []).append(name)
        for limit in sorted(by_limit.keys() - {None}):
            of = f" of {first_names(by_limit[limit])}" * (len(by_limit) > 1)
            parts.append(f"at most {in_words(limit)} {unit} per run{of}")
    groups = [name for name in setting_columns(runs) if name.partition(".")[0] in OF_PROBLEM]
    if differing := [name for name in groups if runs[name].nunique(dropna=False) > 1]:
        parts.append(f"runs differ in {', '.join(differing)}, so their errors do not compare")
    return ", ".join(parts)


def _seeds(seeds: pd.Series[int]) -> str:
    """For example "seeds 0 to 4"."""
    low, high, count = int(seeds.min()), int(seeds.max()), seeds.nunique()
    if count == 1:
        return f"seed {low}"
    return f"{'' if count == high - low + 1 else f'{count} '}seeds {low} to {high}"
