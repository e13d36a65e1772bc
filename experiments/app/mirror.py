"""A mirror of finished runs in a tracker, written after the last of them, outside of every clock.

The files of a root are the truth. What a tracker holds can be deleted and written again from them
by `python -m experiments.sync ROOT`, so nothing that befalls a tracker befalls a run.
"""

from __future__ import annotations

import contextlib
import importlib.util
import math
import re
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from tqdm import tqdm

from experiments.app.build import ConfigError
from experiments.app.instantiation import MissingLibraryError
from experiments.app.plan import Request
from miho.study import DamagedRun, Store, StoredRun, read_run
from miho.study.compaction import error_of
from miho.study.identity import canonical, sha256

MISSING = "mlflow: is not installed; pip install 'miho[mlflow]'"

HOPELESS = 3
"""Failures in a row after which a tracker is given up."""
SLOW_SECONDS = 2.0
"""A tracker that takes longer for a run is not waited for at the end of a sweep."""


class TrackerError(OSError):
    """A tracker cannot be reached, is full or does not fit; the runs themselves are safe."""


@dataclass(frozen=True)
class Entry:
    """A run as a tracker holds it: `whole` if its last part was written, `numbers` its results."""

    key: str
    id: str
    digest: str
    whole: bool
    numbers: Mapping[str, float]


class Tracker(Protocol):
    """Where runs are mirrored to; every method may fail with any exception."""

    def alone(self) -> contextlib.AbstractContextManager[object]:
        """Keep other processes from writing meanwhile."""

    def entries(self, run: str | None = None) -> list[Entry]:
        """All runs, or those with this id; there should be one."""

    def add(self, stored: StoredRun) -> None:
        """Write a run; what makes the entry whole comes last."""

    def remove(self, entry: Entry) -> None:
        """Take a run away."""


def digest_of(stored: StoredRun) -> str:
    """SHA-256 of a run's result, which holds those of its other files."""
    return sha256(canonical(dict(stored.result)))


def numbers_of(stored: StoredRun) -> dict[str, float]:
    """The results that a tracker holds beside the curve; what is not finite is left out.

    `error` is the root of the loss in the problem's unit, times are in seconds.
    """
    result = stored.result
    spent = ("evaluations", "seconds", "cpu_seconds", "setup_seconds")
    numbers = {"error": error_of(result["loss"]), **{key: float(result[key]) for key in spent}}
    theta = result["theta"] or [math.nan] * len(result["parameters"])
    for parameter, value in zip(result["parameters"], theta, strict=True):
        numbers[word(f"theta.{parameter['name']}")] = float(value)
    return {key: value for key, value in numbers.items() if math.isfinite(value)}


def word(name: str) -> str:
    """A name that every tracker takes: letters, digits, '_', '-', '.' and spaces."""
    return re.sub(r"[^\w.\- ]", "_", name, flags=re.ASCII)[:250]


def is_right(entry: Entry, stored: StoredRun) -> bool:
    """Whether an entry is whole and equals the files."""
    equal = entry.digest == digest_of(stored) and entry.numbers == numbers_of(stored)
    return entry.whole and equal


def mirror_run(tracker: Tracker, stored: StoredRun) -> str:
    """Make the tracker hold this run once and rightly; "there", "added" or "repaired"."""
    with tracker.alone():
        entries = tracker.entries(stored.result["id"])
        right = [entry for entry in entries if is_right(entry, stored)][:1]
        for entry in entries:
            if entry not in right:
                tracker.remove(entry)
        if not right:
            tracker.add(stored)
    if len(entries) > len(right):
        return "repaired"
    return "there" if right else "added"


@dataclass(frozen=True)
class Synced:
    """How many runs a tracker had, how many were written, and why others were not."""

    there: int
    added: int
    repaired: int
    failed: dict[str, str] = field(default_factory=dict)


def sync(folders: Sequence[Path], tracker: Tracker, slow: float = math.inf) -> Synced:
    """Make the tracker hold the finished runs in these folders.

    Gives up after failures in a row, or runs in a row that each took longer than `slow` seconds.
    """
    held: dict[str, list[Entry]] = {}
    for entry in tracker.entries():
        held.setdefault(entry.id, []).append(entry)
    counts = {"there": 0, "added": 0, "repaired": 0}
    failed: dict[str, str] = {}
    in_a_row = 0
    for folder in tqdm(folders, desc="mirror", leave=False, disable=None, unit="run"):
        if in_a_row == HOPELESS:
            failed[str(folder)] = "not tried after several failures or slow answers"
            continue
        began = time.monotonic()
        try:
            stored = read_run(folder)
            entries = held.get(stored.result["id"], [])
            right = len(entries) == 1 and is_right(entries[0], stored)
            counts["there" if right else mirror_run(tracker, stored)] += 1
            in_a_row = in_a_row + 1 if time.monotonic() - began > slow else 0
        except DamagedRun as error:
            failed[str(folder)] = message_of(error)
        except Exception as error:  # noqa: BLE001 -- whatever a tracker does is reported
            failed[str(folder)] = message_of(error)
            in_a_row += 1
    return Synced(**counts, failed=failed)


def check_tracking(tracking: Mapping[str, Any]) -> bool:
    """Whether a tracker is asked for; raises ConfigError for one that is not to be had."""
    tracker = tracking.get("tracker")
    if tracker is None:
        return False
    if tracker != "mlflow":
        raise ConfigError(f"tracking.tracker: is {tracker!r}; expected mlflow, or null for none")
    if importlib.util.find_spec("mlflow") is None:
        raise MissingLibraryError(MISSING)
    return True


def mirror_runs(plan: Sequence[Request], tracking: Mapping[str, Any]) -> None:
    """Have the tracker of `tracking`, if there is one, hold what is finished of a plan."""
    if not check_tracking(tracking):
        return
    for root, folders in _finished(plan).items():
        place = Path(root), tracking.get("uri"), tracking.get("experiment")
        mirror(Path(root), folders, partial(_connect, *place))


def say_unmirrored(plan: Sequence[Request], tracking: Mapping[str, Any]) -> None:
    """Print for each root, on stderr, that a signal kept finished runs from the tracker, if any."""
    if not check_tracking(tracking):
        return
    for root, folders in _finished(plan).items():
        print(
            f"mirror: interrupted, so {len(folders)} finished runs may not be in the tracker; "
            f"run python -m experiments.sync {root}",
            file=sys.stderr,
        )


def _finished(plan: Sequence[Request]) -> dict[str, list[Path]]:
    """The folders of finished runs of a plan by their root."""
    folders: dict[str, list[Path]] = {}
    for request in plan:
        store = Store(Path(request.root))
        if store.has_result(request.identity):
            folders.setdefault(request.root, []).append(store.folder(request.identity))
    return folders


def _connect(root: Path, uri: str | None, experiment: str | None) -> Tracker:
    from experiments.app.mlflow_tracker import connect  # which few ask for

    return connect(root, uri, experiment)


def mirror(root: Path, folders: Sequence[Path], connect: Callable[[], Tracker]) -> None:
    """Make a tracker hold these finished runs of a root, or say once, on stderr, what it lacks.

    Whatever befalls the tracker, the runs are safe: what it does not take, or takes slowly, is left
    to `python -m experiments.sync`.
    """
    if not folders:
        return
    missing, reason = len(folders), "interrupted"
    try:
        failed = sync(folders, connect(), slow=SLOW_SECONDS).failed
        missing, reason = len(failed), next(iter(failed.values()), "")
    except Exception as error:  # noqa: BLE001 -- whatever a tracker does is reported
        reason = message_of(error)
    finally:  # also after Ctrl-C
        if missing:
            print(
                f"mirror: {missing} of {len(folders)} runs are not in the tracker yet ({reason}); "
                f"run python -m experiments.sync {root}",
                file=sys.stderr,
            )


def message_of(error: BaseException) -> str:
    """An error in one line of at most 200 characters, without the passwords of addresses."""
    text = " ".join(f"{error}".split()) or type(error).__name__
    return re.sub(r"//[^/@\s]+@", "//", text)[:200]
