"""What a finished run was made of, against what it would be made of now."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from miho.study.files import DamagedRun
from miho.study.identity import Identity
from miho.study.manifest import other_settings
from miho.study.store import Store, read_run


class ResumeRefused(Exception):  # noqa: N818 -- a decision for the user, no error
    """Finished runs of the same request were made of something else; says of what."""


def refuse_changes(
    store: Store,
    runs: Mapping[str, Identity],
    *,
    fresh: bool,
    overrides: Sequence[str] | None = None,
) -> None:
    """Raise ResumeRefused if finished runs are there that were asked for alike, but are of other
    code, data or packages, or, where the same `overrides` gave them before, of other settings.

    Old and new runs never stand side by side as one method: with `fresh`, the old ones are set
    aside, and nothing is deleted. `runs` maps the words that each was asked in to who it is.
    """
    old = [(folder, _changes(who, folder)) for who, folder in store.others(runs.values())]
    if overrides is not None:
        old += other_settings(store.root, overrides, runs)
    if fresh:
        for folder, _ in old:
            store.set_aside(folder)
        return
    counts = Counter(change for _, changes in old for change in changes)
    if counts:
        text = ", ".join(f"{change} ({count} runs)" for change, count in counts.items())
        raise ResumeRefused(
            f"{store.root}: holds finished runs made before a change of {text}; set them aside "
            "and start afresh with fresh=true, or choose another root"
        )


def _changes(identity: Identity, folder: Path) -> list[str]:
    """In words, how a finished run of the same request differs."""
    try:
        result = read_run(folder).result
    except DamagedRun:
        return []
    changes = [what for what in ("code", "data") if result[what] != getattr(identity, what)]
    before: Mapping[str, Any] = result.get("packages", {})
    for name in sorted({*before, *identity.packages}):
        old, new = before.get(name, "none"), identity.packages.get(name, "none")
        if old != new:
            changes.append(f"{name} from {old} to {new}")
    return changes
