"""Sweeps made of synthetic frames, as if read from a root."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import pandas as pd

from miho.analysis.pages.sweep_runs import Origin, Sweep, json_leaves
from miho.analysis.variants import named_apart, with_names_of
from miho.study.settings import Parts, RunRequest, differing, parts_of

ENVIRONMENT = {
    "time": "2026-11-21T18:44:25+00:00",
    "python": "3.11.7",
    "packages": {"numpy": "2.4.6"},
    "processor": "AMD EPYC",
    "cores": 2,
    "load": [0.5, 0.4, 0.3],
    "threads": [1, 1],
}


def origin(
    config: Mapping[str, object] | None = None, *, code: str = "c0de" * 16, data: str = "da7a" * 16,
    **environment: object,
) -> Origin:  # fmt: skip
    leaves = {
        "model": {"_target_": "miho.vehicle.models.Pacejka"},
        "dataset": {"_target_": "miho.vehicle.data.sample_tir"},
        "loss": {"_target_": "miho.identification.Square"},
        **(config or {}),
    }
    return Origin(code, data, json_leaves(leaves), json_leaves(ENVIRONMENT | environment))


def sweep_of(runs: pd.DataFrame, curves: pd.DataFrame, **folders: Origin) -> Sweep:
    """A sweep of these runs; `folders` are origins that differ, by the id of the run."""
    runs = runs.assign(folder=runs["id"], dimension=5)
    origins = {str(run): folders.get(str(run), origin()) for run in runs["id"]}
    names = runs[["problem", "optimizer", "seed"]].itertuples(index=False)
    asked = [
        RunRequest(*name, parts(where.config), where.code, where.data)
        for name, where in zip(names, origins.values(), strict=True)
    ]
    runs = named_apart(pd.concat([runs, differing(asked).set_axis(runs.index)], axis=1))
    nothing = pd.DataFrame({"folder": [], "reason": []}, dtype=str)
    return Sweep(runs, with_names_of(curves, runs), nothing, origins)


def parts(settings: Mapping[str, str]) -> Parts:
    """The groups of a configuration from its leaves, which are JSON texts by dotted path."""
    tree: dict[str, Any] = {}
    for path, text in settings.items():
        *groups, last = path.split(".")
        node = tree
        for group in groups:
            node = node.setdefault(group, {})
        node[last] = json.loads(text)
    return parts_of(json.dumps(tree).encode())


def embedded(html: str, identity: str) -> dict[str, object]:
    """The JSON that a page carries under an id."""
    start = html.index(f'id="{identity}">') + len(f'id="{identity}">')
    data: dict[str, object] = json.loads(html[start : html.index("</script>", start)])
    return data
