"""Configurations that somebody else wrote: looked at before anything composes them.

A reader of YAML expands what it reads. Some lines can stand for more than any memory holds, go
deeper than Python does, or hold themselves.
"""

from __future__ import annotations

from pathlib import Path

import yaml

LARGEST = 1 << 20
"""No configuration is larger, in bytes."""
DEEPEST = 50
MOST_ALIASES = 1000
MOST_NODES = 100_000
"""How many nodes a file may stand for, once its aliases are replaced by what they name."""
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class ReceivedError(ValueError):
    """One line naming the file and what is wrong with it."""


def check_folder(folder: Path) -> None:
    """Raise ReceivedError for the first file in a folder of options that must not be composed."""
    for path in sorted((*folder.rglob("*.yaml"), *folder.rglob("*.yml"))):
        check_file(path)


def check_file(path: Path) -> None:
    """Raise ReceivedError if a file is none, is large, deep, expands to much or holds itself."""
    if not path.is_file():
        raise ReceivedError(f"{path}: is not a regular file; remove it")
    if path.stat().st_size > LARGEST:
        raise ReceivedError(f"{path}: is larger than {LARGEST >> 20} MiB; no configuration is")
    try:
        _check_events(path)
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        line = " ".join(str(error).split())
        raise ReceivedError(f"{path}: is not YAML: {line}; correct it") from None


def _check_events(path: Path) -> None:
    """Count what the file stands for without building it: an alias counts as what it names."""
    sizes: dict[str, int] = {}
    open_nodes: list[tuple[str | None, int]] = []
    aliases = total = 0
    with path.open("rb") as file:
        for event in yaml.parse(file, Loader=LOADER):
            size = 0
            if isinstance(event, yaml.CollectionStartEvent):
                open_nodes.append((event.anchor, total))
                total += 1
                if len(open_nodes) > DEEPEST:
                    raise ReceivedError(f"{path}: is nested deeper than {DEEPEST}; flatten it")
            elif isinstance(event, yaml.CollectionEndEvent):
                anchor, start = open_nodes.pop()
                if anchor is not None:
                    sizes[anchor] = total - start
            elif isinstance(event, yaml.ScalarEvent):
                size = 1
                if event.anchor is not None:
                    sizes[event.anchor] = 1
            elif isinstance(event, yaml.AliasEvent):
                if event.anchor in {anchor for anchor, _ in open_nodes}:
                    raise ReceivedError(f"{path}: {event.anchor!r} holds itself; remove the alias")
                aliases += 1
                size = sizes.get(event.anchor, 1)
            total += size
            if total > MOST_NODES or aliases > MOST_ALIASES:
                raise ReceivedError(
                    f"{path}: stands for more than {MOST_NODES:,} values or {MOST_ALIASES:,} "
                    "aliases; no configuration does"
                )
