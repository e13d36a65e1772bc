"""Options of the group `problem` that a table lists: published problems, each in a box by rule.

`conf/problem/published.csv` has the best known error of each and the evidence for it;
`baselines.problems.posed` has the rule.
"""

from __future__ import annotations

import csv
import textwrap
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml

TABLE = Path(__file__).parents[2] / "conf" / "problem" / "published.csv"


@cache
def recorded() -> Mapping[str, tuple[float, str]]:
    """Return the best known error of each problem of the table, and the evidence for it."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return MappingProxyType(
        {row["problem"]: (float(row["optimum"]), row["evidence"]) for row in rows}
    )


def settings_of(name: str) -> dict[str, Any]:
    """Return the configuration of a problem of the table, like a file of conf/problem."""
    from baselines.problems.posed import posed_problem  # needs NumPy
    from baselines.problems.published_model import PublishedModel

    posed = posed_problem(name)
    optimum, evidence = recorded()[name]
    groups = {"dataset": "zero_residuals", "model": "residual_system", "space": None}
    dataset: dict[str, Any] = {"rows": len(posed.dataset)}
    model: dict[str, Any]
    if isinstance(posed.model, PublishedModel):
        groups |= {"dataset": "published", "model": "published"}
        dataset, model = {"name": posed.dataset.name}, {"name": posed.model.name}
    else:
        model = {"system": posed.model.system, "length": posed.model.length}
    facts = {"name": name, "family": posed.family, "optimum": optimum}
    if optimum < posed.resolution:
        facts["resolution"] = posed.resolution
    space: dict[str, dict[str, Any]] = {}
    for parameter, (low, high, scale) in posed.ranges.items():
        space[parameter] = {"unit": "-", "low": low, "high": high}
        if scale != "linear":
            space[parameter]["scale"] = scale
    return {
        "defaults": [{f"override /{group}": option} for group, option in groups.items()],
        "dataset": dataset,
        "model": model,
        "problem": facts | {"evidence": evidence},
        "space": space,
    }


def text_of(name: str) -> str:
    """Return the text that a file of conf/problem would have."""
    from baselines.problems.posed import posed_problem

    lines = (
        line
        for text in posed_problem(name).about.splitlines()
        for line in textwrap.wrap(text, 100, initial_indent="# ", subsequent_indent="# ")
    )
    settings = yaml.safe_dump(
        settings_of(name), sort_keys=False, default_flow_style=None, width=100
    )
    return "\n".join(["# @package _global_", *lines, settings]).strip()
