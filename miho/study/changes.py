"""Whether finished runs are still valid: of the same code, data, packages and settings as now."""

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
    """Finished runs of the same request are of other code, data, packages or settings."""


def refuse_changes(
    store: Store,
    runs: Mapping[str, Identity],
    *,
    fresh: bool,
    overrides: Sequence[str] | None = None,
) -> None:
    """Raise ResumeRefused if there are finished runs of the same requests that are of other code,
    data or packages, or, where the same `overrides` gave them before, of other settings.

    Old and new runs never stand side by side as one method: with `fresh`, the old ones are set
    aside, and nothing is deleted. `runs` maps the overrides of each run, in words, to its identity.
    """
    outdated = store.outdated(runs.values())
    old = [(folder, _changes(identity, folder)) for identity, folder in outdated]
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
    """How a finished run of the same request differs from this identity, in words."""
    try:
        result = read_run(folder).result
    except DamagedRun:
        return []
    changes = [part for part in ("code", "data") if result[part] != getattr(identity, part)]
    before: Mapping[str, Any] = result.get("packages", {})
    for name in sorted({*before, *identity.packages}):
        old, new = before.get(name, "none"), identity.packages.get(name, "none")
        if old != new:
            changes.append(f"{name} from {old} to {new}")
    return changes
