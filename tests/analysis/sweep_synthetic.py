"""Sweeps made of synthetic frames, as if read from a root."""

from __future__ import annotations

import json
from collections.abc import Mapping

import pandas as pd

from miho.analysis.pages.sweep_runs import Origin, Sweep, json_leaves, with_distinct_names

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
        "model": {"_target_": "miho.models.Pacejka"},
        "dataset": {"_target_": "miho.data.sample_tir"},
        "loss": {"_target_": "miho.identification.Square"},
        **(config or {}),
    }
    return Origin(code, data, json_leaves(leaves), json_leaves(ENVIRONMENT | environment))


def sweep_of(runs: pd.DataFrame, curves: pd.DataFrame, **folders: Origin) -> Sweep:
    """A sweep of these runs; `folders` are origins that differ, by the id of the run."""
    runs = runs.assign(folder=runs["id"], dimension=5)
    origins = {str(run): folders.get(str(run), origin()) for run in runs["id"]}
    labelled = with_distinct_names(runs, list(origins.values()))
    names = labelled.set_index("id")
    curves = curves.assign(
        **{name: curves["id"].map(names[name]) for name in ("problem", "optimizer")}
    )
    nothing = pd.DataFrame({"folder": [], "reason": []}, dtype=str)
    return Sweep(labelled, curves, nothing, origins)


def embedded(html: str, identity: str) -> dict[str, object]:
    """The JSON that a page carries under an id."""
    start = html.index(f'id="{identity}">') + len(f'id="{identity}">')
    data: dict[str, object] = json.loads(html[start : html.index("</script>", start)])
    return data
