"""What a sweep consisted of, by the words it was asked in: the same words must mean the same."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from miho.study import Identity, Store, write_text
from miho.study.changes import ResumeRefused
from miho.study.identity import canonical, sha256
from miho.study.places import inside
from miho.study.store import RESULT

MANIFESTS = ".sweeps"


def write_manifest(root: Path, overrides: Sequence[str], runs: Mapping[str, Identity]) -> None:
    """Keep the settings of the runs that these overrides asked for, by what each was asked in."""
    path = _path(root, overrides)
    path.parent.mkdir(parents=True, exist_ok=True)
    about = {
        "overrides": list(overrides),
        "runs": {
            asked: {
                "place": [one.problem, one.optimizer, one.id],
                "config": dict(one.config),
            }
            for asked, one in runs.items()
        },
    }
    write_text(path, json.dumps(about, indent=1) + "\n")


def refuse_other_settings(
    root: Path, overrides: Sequence[str], runs: Mapping[str, Identity], *, fresh: bool
) -> None:
    """Raise ResumeRefused if the same overrides once gave other settings, of which runs are done.

    So it is after an edit of a file in conf/. With `fresh` the old runs are set aside.
    """
    changed: dict[str, int] = {}
    for asked, entry in _read(_path(root, overrides)).items():
        identity = runs.get(asked)
        if identity is None or entry["config"] == dict(identity.config):
            continue
        folder = inside(root, *entry["place"])
        if not (folder / RESULT).is_file():
            continue
        if fresh:
            Store(root).set_aside(folder)
            continue
        for key in _different(entry["config"], dict(identity.config)):
            changed[key] = changed.get(key, 0) + 1
    if changed:
        told = ", ".join(f"{key} ({count} runs)" for key, count in changed.items())
        raise ResumeRefused(
            f"{root}: the same sweep was made with other settings of {told}; set its runs aside "
            "and start afresh with fresh=true, or choose another root"
        )


def _path(root: Path, overrides: Sequence[str]) -> Path:
    return root / MANIFESTS / f"{sha256(canonical(list(overrides)))[:16]}.json"


def _read(path: Path) -> dict[str, dict[str, Any]]:
    """The runs of a manifest; none where it is absent or not readable as one."""
    try:
        runs = json.loads(path.read_text(encoding="utf-8"))["runs"]
        whole = {asked: one for asked, one in runs.items() if {"place", "config"} <= set(one)}
        return {asked: one for asked, one in whole.items() if len(one["place"]) == 3}
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return {}


def _different(old: Any, new: Any, key: str = "") -> Iterator[str]:
    """The key paths at which two configurations differ."""
    if not (isinstance(old, dict) and isinstance(new, dict)):
        yield key
        return
    for name in sorted({*old, *new}):
        place = f"{key}.{name}" if key else name
        if old.get(name) != new.get(name):
            yield from _different(old.get(name), new.get(name), place)
