"""Copies of finished runs in a tracker, written after the last run and not part of its seconds.

The files of a root are authoritative. The entries of a tracker can be deleted and rewritten from
them with `python -m experiments.sync ROOT`; a failing tracker never affects a run.
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
from miho.study.curves import error_of
from miho.study.identity import canonical, sha256

MISSING = "mlflow: is not installed; pip install 'miho[mlflow]'"

HOPELESS = 3
"""Number of consecutive failures after which a tracker is given up."""
SLOW_SECONDS = 2.0
"""Longest time [s] for a run at the end of a sweep; a slower tracker is given up."""


class TrackerError(OSError):
    """A tracker cannot be reached, is full or does not fit; the stored runs are safe."""


@dataclass(frozen=True)
class Entry:
    """A run in a tracker: `whole` if it was written completely, `numbers` are its results."""

    key: str
    id: str
    digest: str
    whole: bool
    numbers: Mapping[str, float]


class Tracker(Protocol):
    """A store for copies of runs; every method may fail with any exception."""

    def alone(self) -> contextlib.AbstractContextManager[object]:
        """Context in which no other process writes."""

    def entries(self, run: str | None = None) -> list[Entry]:
        """Entries of all runs, or of the run with this id (normally one)."""

    def add(self, stored: StoredRun) -> None:
        """Write a run; the mark of a complete entry comes last."""

    def remove(self, entry: Entry) -> None:
        """Remove a run."""


def digest_of(stored: StoredRun) -> str:
    """SHA-256 of the result of a run, which contains the checksums of its other files."""
    return sha256(canonical(dict(stored.result)))


def numbers_of(stored: StoredRun) -> dict[str, float]:
    """Results that a tracker stores in addition to the curve, without non-finite values.

    `error` is the root of the loss in the unit of the problem; times are in seconds.
    """
    result = stored.result
    spent = ("evaluations", "seconds", "cpu_seconds", "setup_seconds")
    numbers = {"error": error_of(result["loss"]), **{key: float(result[key]) for key in spent}}
    theta = result["theta"] or [math.nan] * len(result["parameters"])
    for parameter, value in zip(result["parameters"], theta, strict=True):
        numbers[word(f"theta.{parameter['name']}")] = float(value)
    return {key: value for key, value in numbers.items() if math.isfinite(value)}


def word(name: str) -> str:
    """Name that every tracker accepts, of letters, digits, '_', '-', '.' and spaces."""
    return re.sub(r"[^\w.\- ]", "_", name, flags=re.ASCII)[:250]


def is_right(entry: Entry, stored: StoredRun) -> bool:
    """Whether an entry is complete and equal to the files."""
    equal = entry.digest == digest_of(stored) and entry.numbers == numbers_of(stored)
    return entry.whole and equal


def mirror_run(tracker: Tracker, stored: StoredRun) -> str:
    """Make the tracker contain this run once and correctly: "there", "added" or "repaired"."""
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
    """Number of runs that were there, added or repaired, and the reasons why others failed."""

    there: int
    added: int
    repaired: int
    failed: dict[str, str] = field(default_factory=dict)


def sync(folders: Sequence[Path], tracker: Tracker, slow: float = math.inf) -> Synced:
    """Make the tracker contain the finished runs in these folders.

    Gives up after consecutive failures, or consecutive runs that took longer than `slow` seconds.
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
    """Whether a tracker is configured; raises ConfigError if it is not available."""
    tracker = tracking.get("tracker")
    if tracker is None:
        return False
    if tracker != "mlflow":
        raise ConfigError(f"tracking.tracker: is {tracker!r}; expected mlflow, or null for none")
    if importlib.util.find_spec("mlflow") is None:
        raise MissingLibraryError(MISSING)
    return True


def mirror_runs(plan: Sequence[Request], tracking: Mapping[str, Any]) -> None:
    """Copy the finished runs of a plan to the tracker of `tracking`, if there is one."""
    if not check_tracking(tracking):
        return
    for root, folders in _finished(plan).items():
        place = Path(root), tracking.get("uri"), tracking.get("experiment")
        mirror(Path(root), folders, partial(_connect, *place))


def say_unmirrored(plan: Sequence[Request], tracking: Mapping[str, Any]) -> None:
    """Print on stderr, for each root, that a signal prevented the copy to the tracker, if any."""
    if not check_tracking(tracking):
        return
    for root, folders in _finished(plan).items():
        print(
            f"mirror: interrupted, so {len(folders)} finished runs may not be in the tracker; "
            f"run python -m experiments.sync {root}",
            file=sys.stderr,
        )


def _finished(plan: Sequence[Request]) -> dict[str, list[Path]]:
    """Folders of the finished runs of a plan, by root."""
    folders: dict[str, list[Path]] = {}
    for request in plan:
        store = Store(Path(request.root))
        if store.has_result(request.identity):
            folders.setdefault(request.root, []).append(store.folder(request.identity))
    return folders


def _connect(root: Path, uri: str | None, experiment: str | None) -> Tracker:
    from experiments.app.mlflow_tracker import connect  # rarely needed

    return connect(root, uri, experiment)


def mirror(root: Path, folders: Sequence[Path], connect: Callable[[], Tracker]) -> None:
    """Copy these finished runs of a root to a tracker, or print on stderr how many are missing.

    The stored runs are safe in any case; `python -m experiments.sync` copies the runs that the
    tracker refused or for which it was too slow.
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
    """Error in one line of at most 200 characters, without passwords in addresses."""
    text = " ".join(f"{error}".split()) or type(error).__name__
    return re.sub(r"//[^/@\s]+@", "//", text)[:200]
