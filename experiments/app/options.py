"""Groups and options in conf/ and in further folders."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

CONF = Path(__file__).parents[2] / "conf"


def groups_of(folders: Sequence[Path] = (CONF,)) -> list[str]:
    """Names of the groups, without the groups of Hydra."""
    names = {path.name for folder in folders for path in folder.iterdir() if path.is_dir()}
    return sorted(name for name in names - {"hydra"} if options_of(name, folders))


def options_of(group: str, folders: Sequence[Path] = (CONF,)) -> list[str]:
    """Names of the options of a group; in subfolders the path, such as r500/miho."""
    if not group or not set(group.split("/")).isdisjoint({"", ".", ".."}):
        return []
    return sorted(
        {
            str(path.relative_to(folder / group).with_suffix(""))
            for folder in folders
            for path in (folder / group).rglob("*.yaml")
        }
    )


def source(group: str, option: str, folders: Sequence[Path] = (CONF,)) -> str:
    """Text of the file of an option; empty if a package registers the option."""
    for folder in folders:
        path = folder / group / f"{option}.yaml"
        if path.is_file():
            return path.read_text(encoding="utf-8").strip()
    return ""
