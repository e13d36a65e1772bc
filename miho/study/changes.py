"""Check whether finished runs have the same code, data, packages and settings as now."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from miho.study.files import DamagedRun
from miho.study.identity import Identity
from miho.study.manifest import other_settings
from miho.study.store import Store, read_run


class ResumeRefused(Exception):  # noqa: N818 -- a decision for the user, not an error
    """Finished runs of the same request have other code, data, packages or settings."""


def refuse_changes(
    store: Store,
    runs: Mapping[str, Identity],
    *,
    fresh: bool,
    overrides: Sequence[str] | None = None,
) -> None:
    """Refuse to mix new runs with finished runs of the same requests that have changed.

    Finished runs have changed if they have other code, data or packages, or other settings although
    the same overrides requested them; `overrides` of the sweep lead to its manifest. `runs` has the
    identity of each run by its overrides, joined by spaces. With `fresh` the changed runs are set
    aside, and nothing is deleted; else ResumeRefused is raised.
    """
    outdated = store.outdated(runs.values())
    superseded = [(folder, _changes(identity, folder)) for identity, folder in outdated]
    if overrides is not None:
        superseded += other_settings(store.root, overrides, runs)
    if fresh:
        for folder, _ in superseded:
            store.set_aside(folder)
        return
    counts = Counter(change for _, changes in superseded for change in changes)
    if counts:
        text = ", ".join(f"{change} ({count} runs)" for change, count in counts.items())
        raise ResumeRefused(
            f"{store.root}: has finished runs from before a change of {text}; set them aside "
            "and start again with fresh=true, or choose another root"
        )


def _changes(identity: Identity, folder: Path) -> list[str]:
    """Differences between a finished run and an identity with the same request, as phrases."""
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
