"""What a finished run was made of, against what it would be made of now."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from miho.study.files import DamagedRun
from miho.study.identity import Identity
from miho.study.store import Store, read_run


class ResumeRefused(Exception):  # noqa: N818 -- a decision for the user, no error
    """Finished runs of the same request were made of something else; says of what."""


def refuse_changes(store: Store, identities: Iterable[Identity], *, fresh: bool) -> None:
    """Raise ResumeRefused if a run's like is there, but of other code, data or packages.

    Old and new runs never stand side by side as one method: with `fresh`, the old ones are set
    aside, and nothing is deleted.
    """
    changed: dict[str, int] = {}
    for identity, folder in store.others(identities):
        if fresh:
            store.set_aside(folder)
            continue
        for change in _changes(identity, folder):
            changed[change] = changed.get(change, 0) + 1
    if changed:
        told = ", ".join(f"{change} ({count} runs)" for change, count in changed.items())
        raise ResumeRefused(
            f"{store.root}: holds finished runs made before a change of {told}; set them aside "
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
