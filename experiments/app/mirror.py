"""Copies of finished runs in a tracker, written after the last run and not part of its seconds.

The files of a root are authoritative, and the copy goes one way: a run that the tracker lacks is
written, a run that it has is left alone. `python -m experiments.sync ROOT` does this at any time,
and a failing tracker never affects a run.
"""

import importlib.util
import math
import re
import shlex
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from tqdm import tqdm

from experiments.app.build import ConfigError
from experiments.app.instantiation import MissingLibraryError
from experiments.app.plan import Request
from miho.study import DamagedRun, Store, StoredRun, read_run
from miho.study.identity import canonical, sha256

MISSING = "mlflow: is not installed; pip install 'miho[mlflow]'"

HOPELESS = 3
"""Number of consecutive failures after which a tracker is given up."""
SLOW_SECONDS = 2.0
"""Longest time [s] for a run at the end of a sweep; a slower tracker is given up."""


class TrackerError(OSError):
    """A tracker cannot be reached, is full or does not fit; the stored runs are safe."""


class Tracker(Protocol):
    """A store for copies of runs; every method may fail with any exception."""

    def digests(self) -> set[str]:
        """`digest_of` each run that was written completely."""

    def add(self, stored: StoredRun) -> None:
        """Write a run, in place of all that was written of it before."""


def digest_of(stored: StoredRun) -> str:
    """SHA-256 of the result of a run, which contains the checksums of its other files."""
    return sha256(canonical(dict(stored.result)))


@dataclass(frozen=True)
class Synced:
    """Number of runs that were there or added, and the reasons why others failed, by folder."""

    there: int
    added: int
    failed: dict[str, str]


def sync(folders: Sequence[Path], tracker: Tracker, slow: float = math.inf) -> Synced:
    """Add the finished runs in these folders that the tracker lacks.

    Gives up after consecutive failures, or consecutive runs that took longer than `slow` seconds.
    """
    present = tracker.digests()
    there = added = in_a_row = 0
    failed: dict[str, str] = {}
    for folder in tqdm(folders, desc="mirror", leave=False, disable=None, unit="run"):
        if in_a_row == HOPELESS:
            failed[str(folder)] = "not tried after several failures or slow answers"
            continue
        began = time.monotonic()
        try:
            stored = read_run(folder)
            if digest_of(stored) in present:
                there += 1
                continue
            tracker.add(stored)
            added += 1
            in_a_row = in_a_row + 1 if time.monotonic() - began > slow else 0
        except DamagedRun as error:
            failed[str(folder)] = message_of(error)
        except Exception as error:  # noqa: BLE001 -- whatever a tracker does is reported
            failed[str(folder)] = message_of(error)
            in_a_row += 1
    return Synced(there, added, failed)


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


def mirror_runs(
    plan: Sequence[Request], tracking: Mapping[str, Any], *, interrupted: bool = False
) -> None:
    """Copy the finished runs of a plan to the tracker of `tracking`, if there is one.

    After a signal (`interrupted`) this only prints how many may be missing.
    """
    if not check_tracking(tracking):
        return
    folders: dict[str, list[Path]] = {}
    for request in plan:
        store = Store(Path(request.root))
        if store.has_result(request.identity):
            folders.setdefault(request.root, []).append(store.folder(request.identity))
    for root, finished in folders.items():
        if interrupted:
            _say_missing(Path(root), len(finished), len(finished), "interrupted")
        else:
            place = Path(root), tracking.get("uri"), tracking.get("experiment")
            mirror(Path(root), finished, partial(_connect, *place))


def _connect(root: Path, uri: str | None, experiment: str | None) -> Tracker:
    from experiments.app.mlflow_tracker import connect  # rarely needed

    return connect(root, uri, experiment)


def mirror(root: Path, folders: Sequence[Path], connect: Callable[[], Tracker]) -> None:
    """Copy these finished runs of a root to a tracker, or print on stderr how many are missing.

    The stored runs are safe in any case; `python -m experiments.sync` copies the runs that the
    tracker refused or for which it was too slow.
    """
    missing, reason = len(folders), "interrupted"
    try:
        failed = sync(folders, connect(), slow=SLOW_SECONDS).failed
        missing, reason = len(failed), next(iter(failed.values()), "")
    except Exception as error:  # noqa: BLE001 -- whatever a tracker does is reported
        reason = message_of(error)
    finally:  # also after Ctrl-C
        if missing:
            _say_missing(root, missing, len(folders), reason)


def _say_missing(root: Path, missing: int, runs: int, reason: str) -> None:
    print(
        f"mirror: {missing} of {runs} runs may not be in the tracker ({reason}); "
        f"run python -m experiments.sync {shlex.quote(str(root))}",
        file=sys.stderr,
    )


def message_of(error: BaseException) -> str:
    """Error in one line of at most 200 characters, without passwords in addresses."""
    text = " ".join(f"{error}".split()) or type(error).__name__
    return re.sub(r"//[^/@\s]+@", "//", text)[:200]
