"""Find all finished runs below a root, read once and checked."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from miho.study.files import CONFIG, CURVE, DamagedRun, NoResult, read_checked

DEPTH = 3
"""Runs are in root/<problem>/<optimizer>/<id>."""


class CheckedRun(NamedTuple):
    """A run whose four files match their checksums: its result and the bytes of two files."""

    folder: str
    result: dict[str, Any]
    curve: bytes
    config: bytes


@dataclass(frozen=True)
class Damage:
    """A folder that was skipped, and the reason."""

    folder: str
    reason: str


def scan(root: Path) -> Iterator[CheckedRun | Damage]:
    """The runs below `root`, sorted by folder, without folders that have no result.

    Hidden folders are skipped. Links to folders are not followed, because they can lead out of the
    root; they count as damage, and so do unreadable folders.
    """
    entries = {str(getattr(entry, "folder", entry)): entry for entry in _folders(str(root), DEPTH)}
    for folder in sorted(entries):
        entry = entries[folder]
        if isinstance(entry, Damage):
            yield entry
            continue
        try:
            result, files = read_checked(folder)
            yield CheckedRun(folder, result, files[CURVE], files[CONFIG])
        except NoResult:
            continue
        except DamagedRun as error:
            yield Damage(folder, str(error))


def _folders(top: str, depth: int) -> Iterator[str | Damage]:
    """Folders `depth` levels below `top`, and obstacles on the way there."""
    if depth == 0:
        yield top
        return
    try:
        with os.scandir(top) as entries:
            inside = [entry for entry in entries if not entry.name.startswith(".")]
        for entry in inside:
            if entry.is_dir(follow_symlinks=False):
                yield from _folders(entry.path, depth - 1)
            elif entry.is_dir():
                yield Damage(entry.path, f"{entry.path}: a symbolic link, which is not followed")
    except OSError as error:
        yield Damage(top, f"{top}: {error.strerror}")
