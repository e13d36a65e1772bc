"""A mirror of finished runs in a tracker, written by another process and outside of every clock.

The files of a root are the truth. What a tracker holds can be deleted and written again from them
by `python -m experiments.sync ROOT`, so nothing that befalls a tracker befalls a run.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import math
import os
import re
import select
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from tqdm import tqdm

from experiments.build import ConfigError, MissingLibraryError
from miho.study import DamagedRun, StoredRun, load_runs, read_run
from miho.study.compaction import error_of
from miho.study.identity import canonical, sha256

MISSING = "mlflow: is not installed; pip install 'miho[mlflow]'"

HOPELESS = 3
"""Failures in a row after which a tracker is given up."""


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


def mirrored(tracker: Tracker, stored: StoredRun) -> str:
    """Make the tracker hold this run once and rightly; "there", "added" or "repaired"."""
    with tracker.alone():
        found = tracker.entries(stored.result["id"])
        right = [entry for entry in found if is_right(entry, stored)][:1]
        for entry in found:
            if entry not in right:
                tracker.remove(entry)
        if not right:
            tracker.add(stored)
    if len(found) > len(right):
        return "repaired"
    return "there" if right else "added"


@dataclass(frozen=True)
class Synced:
    """How many runs a tracker had, how many were written, and why others were not."""

    there: int
    added: int
    repaired: int
    failed: dict[str, str] = field(default_factory=dict)


def sync(root: Path, tracker: Tracker) -> Synced:
    """Make the tracker hold every finished run of the root; gives up after failures in a row."""
    held: dict[str, list[Entry]] = {}
    for entry in tracker.entries():
        held.setdefault(entry.id, []).append(entry)
    counts = {"there": 0, "added": 0, "repaired": 0}
    failed: dict[str, str] = {}
    in_a_row = 0
    for folder in tqdm(load_runs(root).runs["folder"], leave=False, disable=None, unit="run"):
        if in_a_row == HOPELESS:
            failed[folder] = "not tried after several failures"
            continue
        try:
            stored = read_run(Path(folder))
            mine = held.get(stored.result["id"], [])
            right = len(mine) == 1 and is_right(mine[0], stored)
            counts["there" if right else mirrored(tracker, stored)] += 1
            in_a_row = 0
        except DamagedRun as error:
            failed[folder] = told(error)
        except Exception as error:  # noqa: BLE001 -- whatever a tracker does is reported
            failed[folder] = told(error)
            in_a_row += 1
    return Synced(**counts, failed=failed)


class Mirror:
    """The sweep's end of a mirror: `push` costs microseconds, never waits and never raises.

    Another process, of the lowest priority, reads the names of finished runs from a pipe and writes
    them to the tracker; `command` starts it and calls `follow` there, with these `settings`. It
    ends after its first failure, and with this process. What does not fit into the pipe or comes
    after a failure is left to `python -m experiments.sync`; `close` says so once, on stderr.
    """

    def __init__(self, root: Path, command: Sequence[str], settings: Mapping[str, Any]) -> None:
        self.root = root
        self.pushed = self.done = 0
        self.reason = ""
        self._heard = b""
        theirs_in, self._orders = os.pipe()
        self._replies, theirs_out = os.pipe()
        for end in (self._orders, self._replies):
            os.set_blocking(end, False)
        self._process: subprocess.Popen[bytes] | None = None
        try:
            self._process = subprocess.Popen(
                command, stdin=theirs_in, stdout=theirs_out, stderr=subprocess.DEVNULL,
                process_group=0,
            )  # fmt: skip
            _give_way(self._process.pid)
        except OSError as error:
            self.reason = str(error)
        finally:
            os.close(theirs_in)
            os.close(theirs_out)
        self._send(dict(settings))

    def push(self, stored: StoredRun) -> None:
        """Hand over a finished run."""
        self.pushed += 1
        self._send(str(stored.folder.absolute()))
        self._listen(0.0)

    def close(self, seconds: float = 10.0) -> None:
        """Give the other process this long to finish, end it, and say what is left to do."""
        if self._process is None and self._orders < 0:
            return
        deadline = time.monotonic() + seconds
        while self.done < self.pushed and not self.reason:
            left = deadline - time.monotonic()
            if left <= 0:
                break
            self._listen(left)
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None
        os.close(self._orders)
        os.close(self._replies)
        self._orders = -1
        if self.done < self.pushed:
            why = f" ({self.reason})" if self.reason else ""
            print(
                f"mirror: {self.pushed - self.done} of {self.pushed} runs are not in the tracker "
                f"yet{why}; run python -m experiments.sync {self.root}",
                file=sys.stderr,
            )

    def _send(self, message: object) -> None:
        """A line into the pipe: whole or, if the pipe is full, not at all."""
        data = json.dumps(message).encode() + b"\n"
        if self.reason or self._orders < 0 or len(data) > select.PIPE_BUF:
            return
        try:
            os.write(self._orders, data)
        except BlockingIOError:
            return
        except OSError:
            self._listen(0.0)
            self.reason = self.reason or "the process that writes it has ended"

    def _listen(self, seconds: float) -> None:
        """Take what the other process has said: a line per run, with the reason if it failed."""
        if self._orders < 0:
            return
        poll = select.poll()
        poll.register(self._replies, select.POLLIN)
        if not poll.poll(1000 * seconds):
            return
        said = os.read(self._replies, 1 << 16)
        *lines, self._heard = (self._heard + said).split(b"\n")
        for line in lines:
            failure = line.decode(errors="replace").strip()
            self.done += not failure
            self.reason = self.reason or failure
        if not said:
            self.reason = self.reason or "the process that writes it has ended"


def _give_way(process: int) -> None:
    """Leave a process 1.5 % of a core that another wants (Linux: weight 15 against 1024)."""
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, process, 19)


def open_mirror(
    root: Path, tracker: str | None, uri: str | None = None, experiment: str | None = None
) -> Mirror | None:
    """The mirror that the node `tracking` of a configuration asks for, if it asks for one."""
    if tracker is None:
        return None
    if tracker != "mlflow":
        raise ConfigError(f"tracking.tracker: is {tracker!r}; expected mlflow, or null for none")
    return mlflow_mirror(root, uri, experiment)


def mlflow_mirror(root: Path, uri: str | None, experiment: str | None) -> Mirror:
    """A mirror in MLflow; raises MissingLibraryError where that is not installed.

    `uri` and `experiment` are those of `experiments.sync.connect`.
    """
    if importlib.util.find_spec("mlflow") is None:
        raise MissingLibraryError(MISSING)
    settings = {"root": str(root.absolute()), "uri": uri, "experiment": experiment}
    return Mirror(root, [sys.executable, "-m", "experiments.sync", "--follow"], settings)


def follow(connect: Callable[[Mapping[str, Any]], Tracker]) -> None:
    """The other end of a `Mirror`: write what stdin names until a failure or the sweep's end."""
    replies = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    tracker = None
    for line in sys.stdin:
        message, failure = json.loads(line), ""
        try:
            if tracker is None:
                tracker = connect(message)
                continue
            mirrored(tracker, read_run(Path(message)))
        except Exception as error:  # noqa: BLE001 -- whatever a tracker does, the runs are safe
            failure = told(error)
        print(failure, file=replies, flush=True)
        if failure:
            return


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(0.25)
    os._exit(1)


def told(error: BaseException) -> str:
    """An error in one line of at most 200 characters, without the passwords of addresses."""
    text = " ".join(f"{error}".split()) or type(error).__name__
    return re.sub(r"//[^/@\s]+@", "//", text)[:200]
