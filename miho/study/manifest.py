"""The manifest of a sweep: its runs and their settings, stored under the sweep's overrides.

    root/.sweeps/<hash of the overrides>.json

It detects that the same overrides later mean other settings. Each distinct part of a configuration
(the model, the dataset ...) is stored once; configurations and runs have its number.
"""

from __future__ import annotations

import contextlib
import json
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from miho.study.files import (
    CURVE,
    LARGEST,
    MALFORMED,
    RESULT,
    DamagedRun,
    decoded,
    read_bytes,
    write_text,
)
from miho.study.identity import Identity, canonical, inside, sha256
from miho.study.store import SUPERSEDED, Store, read_run

MANIFESTS = ".sweeps"
SHOWN = 3
"""Number of names that a message lists."""


IDENTIFY = "experiments.identify -m"


def write_manifest(
    root: Path, overrides: Sequence[str], runs: Mapping[str, Identity], command: str = IDENTIFY
) -> None:
    """Write the settings of a sweep's runs, given by overrides and identity, and its command."""
    path = _path(root, overrides)
    path.parent.mkdir(parents=True, exist_ok=True)
    parts: dict[str, int] = {}  # numbers by the text of each distinct value
    configs: dict[str, int] = {}
    numbers: dict[int, int] = {}  # by the configuration object, which all seeds share
    entries = {}
    for words, identity in runs.items():
        if id(identity.config) not in numbers:
            config = {name: _number(part, parts) for name, part in identity.config.items()}
            numbers[id(identity.config)] = _number(config, configs)
        place = [identity.problem, identity.optimizer, identity.id]
        entries[words] = {"place": place, "config": numbers[id(identity.config)]}
    values = {"parts": [*map(json.loads, parts)], "configs": [*map(json.loads, configs)]}
    made_by = {"command": command, "overrides": list(overrides), "root": str(root)}
    about = {**made_by, **values, "runs": entries}
    write_text(path, canonical(about) + "\n")


def _number(value: Any, numbers: dict[str, int]) -> int:
    """The number of this value or an equal one among distinct values."""
    return numbers.setdefault(canonical(value), len(numbers))


def sweep_commands(root: Path) -> list[list[str]]:
    """Words of the command of each sweep that wrote into a root, the oldest sweep first.

    If the root has been moved since, `root=` names its present place.
    """
    paths = sorted((root / MANIFESTS).glob("*.json"), key=lambda path: path.stat().st_mtime_ns)
    sweeps: list[list[str]] = []
    for path in paths:
        with contextlib.suppress(OSError, *MALFORMED):
            about = decoded(read_bytes(str(path), LARGEST))
            command = str(about.get("command", IDENTIFY)).split()
            overrides = [str(word) for word in about["overrides"]]
            typed = [word for word in overrides if word.startswith("root=")]
            place = typed[-1][5:] if typed else about.get("root", root)
            if "$" not in str(place) and Path(place).resolve() != root.resolve():
                overrides = [word for word in overrides if word not in typed] + [f"root={root}"]
            words = ["python", "-m", *command, *overrides]
            sweeps += [words] * (words not in sweeps)
    return sweeps


def first_names(names: Sequence[str]) -> str:
    """The first few of these names, and the number of the others."""
    more = f" and {len(names) - SHOWN:,} more" * (len(names) > SHOWN)
    return ", ".join(names[:SHOWN]) + more


def other_settings(
    root: Path, overrides: Sequence[str], runs: Mapping[str, Identity]
) -> Iterator[tuple[Path, list[str]]]:
    """Finished runs that the same overrides gave with other settings, and the keys that differ."""
    for words, entry in _read(_path(root, overrides)).items():
        identity = runs.get(words)
        if identity is None or entry["config"] == dict(identity.config):
            continue
        folder = inside(root, *entry["place"])
        if (folder / RESULT).is_file():
            yield folder, list(_differing_keys(entry["config"], dict(identity.config)))


def without_result(root: Path, problem: str | None = None) -> tuple[list[Path], int]:
    """Folders of a root's planned runs without a result, and the number of all planned runs.

    With `problem` only its runs count, and runs that were set aside never do.
    """
    places: dict[Path, None] = {}
    for path in sorted((root / MANIFESTS).glob("*.json")):
        for entry in _read(path).values():
            place = Path(*entry["place"])
            of_problem = problem in (None, place.parts[0])
            if of_problem and not (root / SUPERSEDED / place).exists():
                places[place] = None
    missing = [root / place for place in places if not (root / place / RESULT).is_file()]
    return missing, len(places)


def missing_runs(root: Path, problem: str | None = None) -> str | None:
    """A message about runs of a root's sweeps without results; None if there are none."""
    missing, count = without_result(root, problem)
    if not missing:
        return None
    incomplete = sum((folder / CURVE).is_file() for folder in missing)
    folders = first_names(sorted(map(str, missing)))
    message = f"{len(missing):,} of {count:,} runs of the sweeps here have no {RESULT}: {folders}"
    if incomplete:
        message += f"; {incomplete:,} of them lost it, or were killed while they stored it"
    again = " && ".join(map(shlex.join, sweep_commands(root)))
    return f"{message}; this runs them again: {again}"


def _path(root: Path, overrides: Sequence[str]) -> Path:
    return inside(root, MANIFESTS) / f"{sha256(canonical(list(overrides)))[:16]}.json"


def _read(path: Path) -> dict[str, dict[str, Any]]:
    """Place and configuration of the runs of a manifest; empty if it cannot be read."""
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
        configs = [
            {name: about["parts"][number] for name, number in config.items()}
            for config in about["configs"]
        ]
        return {
            words: {"place": [*map(str, run["place"])], "config": configs[run["config"]]}
            for words, run in about["runs"].items()
            if len(run["place"]) == 3
        }
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return {}


def _differing_keys(old: Any, new: Any, key: str = "") -> Iterator[str]:
    """The key paths that differ between two configurations."""
    if not (isinstance(old, dict) and isinstance(new, dict)):
        yield key
        return
    for name in sorted({*old, *new}):
        place = f"{key}.{name}" if key else name
        if old.get(name) != new.get(name):
            yield from _differing_keys(old.get(name), new.get(name), place)


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
