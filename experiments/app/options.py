"""Groups and options in conf/ and in further folders.

A table lists published problems, each in a box by rule: `conf/problem/published.csv` has the best
known error of each and the evidence for it; `baselines.problems.posed` has the rule.
"""

import csv
import textwrap
from collections.abc import Mapping, Sequence
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


CONF = Path(__file__).parents[2] / "conf"


def groups_of(folders: Sequence[Path] = (CONF,)) -> list[str]:
    """Names of the groups, without the groups of Hydra."""
    names = {path.name for folder in folders for path in folder.iterdir() if path.is_dir()}
    return sorted(name for name in names - {"hydra"} if options_of(name, folders))


def options_of(group: str, folders: Sequence[Path] = (CONF,)) -> list[str]:
    """Names of the options of a group; in subfolders the path, such as r500/miho."""
    if not group or not set(group.split("/")).isdisjoint({"", ".", ".."}):
        return []
    names = {
        str(path.relative_to(folder / group).with_suffix(""))
        for folder in folders
        for path in (folder / group).rglob("*.yaml")
        if not any(part.startswith(".") for part in path.relative_to(folder).parts)
    }
    return sorted(names.union(recorded() if group == "problem" and CONF in folders else ()))


def source(group: str, option: str, folders: Sequence[Path] = (CONF,)) -> str:
    """Text of an option's file or of its row in a table; empty if a package registers it."""
    for folder in folders:
        path = folder / group / f"{option}.yaml"
        if path.is_file():
            return path.read_text(encoding="utf-8").strip()
        if folder == CONF and group == "problem" and option in recorded():
            return text_of(option)
    return ""
