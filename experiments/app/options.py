"""Groups and options in conf/ and in further folders."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from experiments.app.published import recorded, text_of

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
