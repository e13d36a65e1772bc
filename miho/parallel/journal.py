"""Evaluation log (journal) of a run: it keeps expensive evaluations, so that none is repeated."""

from __future__ import annotations

import base64
import contextlib
import errno
import os
import re
import sys
import threading
import time
import weakref
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import orjson
from numpy.typing import NDArray

from miho.parallel.errors import JournalError
from miho.parallel.remote import Raised
from miho.regular_file import NotAFileError, check_regular

FORMAT = 2
SYNCED = 1.0
"""Seconds of evaluations that a power failure may cost. The end of a process costs none."""
Key = tuple[str, bytes]


class Described(Protocol):
    """The problem of a journal."""

    @property
    def description(self) -> str:
        """A text that differs for problems with different values.

        Its first line is a summary.
        """

    @property
    def called_as(self) -> Sequence[Any]:
        """Calling conventions of the problem's functions, which a later run has to reproduce."""


opened: weakref.WeakSet[Journal] = weakref.WeakSet()


def _leave_to_parent() -> None:
    """Close the files in a forked child, so that it does not keep their locks."""
    for journal in list(opened):
        journal.abandon()


if hasattr(os, "register_at_fork"):  # not on every system
    os.register_at_fork(after_in_child=_leave_to_parent)


class Journal:
    """Evaluation log of a run: values by function and parameters, appended to a file.

    Each line is a checksum followed by JSON with arrays in base64. Values are exact, and a damaged
    line affects no other line. The first line describes the problem and its calling conventions.
    The file is created with the first value.

    Parameters
    ----------
    path : path
        The file.
    problem : Described
        The problem whose evaluations are logged.

    Raises
    ------
    JournalError
        If the file is not a journal, belongs to another problem, or is in use by another process.
    """

    def __init__(self, path: str | os.PathLike[str], problem: Described) -> None:
        self.path = Path(path)
        self._problem = problem
        self._values: dict[Key, NDArray[np.float64] | Raised] = {}
        self._places: dict[Key, int] = {}
        self._file: Any = None
        self._failed = False
        self._synced = time.monotonic()
        self._adding = threading.Lock()
        if _is_there(self.path):
            self._open()
        self.loaded = len(self._values)

    @property
    def status(self) -> str:
        """A phrase that describes the values of earlier calls; empty if there are none."""
        known = f"continues from {self.loaded:,} evaluations of an earlier call"
        return known if self.loaded else ""

    def __len__(self) -> int:
        return len(self._values)

    def __iter__(self) -> Iterator[Key]:
        """Keys of all values, in order of addition."""
        return iter(list(self._values))  # other threads add values

    def __contains__(self, key: Key) -> bool:
        return key in self._values

    def __getitem__(self, key: Key) -> NDArray[np.float64] | Raised:
        return self._values[key]

    def values_of(self, task: str) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Parameters and values of a function, without evaluations that raised."""
        return [
            (np.frombuffer(theta, dtype=float), value)
            for (name, theta), value in self._values.items()
            if name == task and not isinstance(value, Raised)
        ]

    def place(self, key: Key) -> int:
        """Position of a value in the order of addition."""
        return self._places[key]

    def add(self, key: Key, value: NDArray[np.float64] | Raised) -> None:
        """Append a value to the file before returning.

        If the file cannot be written, a line on stderr says so and no more values are kept. The run
        continues: an exception here would look like an error of the model.
        """
        entry: dict[str, Any] = {"task": key[0], "theta": _text(key[1])}
        if isinstance(value, Raised):
            entry["raised"] = [value.name, value.message]
        else:
            entry |= {"value": _text(value.tobytes()), "shape": value.shape}
        with self._adding:  # several threads add values
            if key in self._values or self._failed:
                return
            try:
                if self._file is None:
                    self._open()
                self._write(entry)
                self._remember(key, value)
            except JournalError as error:
                self._failed = True
                sys.stderr.write(f"miho: {error}; evaluations are not kept from now on\n")

    def close(self) -> None:
        """Flush the file to the disk; values that are added later are not kept."""
        with self._adding:
            self._failed = True
            if self._file is None:
                return
            with contextlib.suppress(OSError):
                os.fsync(self._file.fileno())
            with contextlib.suppress(OSError):  # the disk may be full
                self._file.close()

    def abandon(self) -> None:
        """Close the file, which another process writes."""
        self._failed, self._adding = True, threading.Lock()
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()
            self._file = None

    def _open(self) -> None:
        """Open, lock and read the file; create it if necessary."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("a+b", buffering=0)
        except OSError as error:
            raise JournalError(
                f"journal {self.path}: {error.strerror}; name another file"
            ) from None
        try:
            opened.add(self)
            _lock(self._file, self.path)
            self._read()
        except BaseException:
            self._file.close()
            self._file = None
            raise

    def _read(self) -> None:
        """Read all values. Raises JournalError if the file is not a journal of this problem."""
        problem, calls = self._problem.description, list(self._problem.called_as)
        self._file.seek(0)
        *lines, tail = self._file.read().split(b"\n")
        entries = [_entry(line) for line in lines]
        first = {"format": FORMAT, "problem": problem, "calls": calls}
        head = first if not lines and _is_cut_short(tail, first) else None
        head = entries[0] if entries else head
        if head is None:
            raise JournalError(f"journal {self.path}: not a journal; name another file")
        if head.get("format") != FORMAT:
            raise JournalError(
                f"journal {self.path}: written by another version of MIHO; name another file, or "
                "delete this one"
            )
        if tail:  # cut short by the end of its process
            self._file.truncate(sum(len(line) + 1 for line in lines))
        if not entries:
            self._write(first)
            return
        if head.get("problem") != problem:
            raise JournalError(
                f"journal {self.path}: belongs to another problem, model or data; name another "
                "file, or delete this one"
            )
        damaged = 0
        for entry in entries[1:]:
            try:
                self._remember(*_value(entry))
            except (TypeError, ValueError, LookupError):
                damaged += 1
        if damaged:
            sys.stderr.write(
                f"miho: journal {self.path}: {damaged} damaged lines were ignored; their values "
                "are evaluated again\n"
            )

    def _remember(self, key: Key, value: NDArray[np.float64] | Raised) -> None:
        self._places.setdefault(key, len(self._places))
        self._values[key] = value

    def _write(self, entry: dict[str, Any]) -> None:
        try:
            line = _line(entry)
            if self._file.write(line) != len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            if time.monotonic() - self._synced >= SYNCED:
                os.fsync(self._file.fileno())
                self._synced = time.monotonic()
        except OSError as error:
            raise JournalError(f"journal {self.path}: {error.strerror}") from None


def calls_of(path: str | os.PathLike[str]) -> Sequence[Any] | None:
    """Return the calling conventions in a journal, or None if there is no journal yet.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    sequence or None
        Calling conventions, see `Described.called_as`.

    Raises
    ------
    JournalError
        If no file can have this name.
    """
    if not _is_there(path):
        return None
    try:
        with Path(path).open("rb") as file:
            first = file.readline()
    except OSError:
        return None
    if not first.endswith(b"\n"):  # cut short before the first value
        return None
    calls = (_entry(first.rstrip(b"\n")) or {}).get("calls")
    return calls if isinstance(calls, list) else ()


def _is_there(path: str | os.PathLike[str]) -> bool:
    """Return whether a file of this name exists. Raises JournalError for an impossible name.

    Pipes and devices are not opened, because that might block.
    """
    try:
        check_regular(path)
    except OSError:  # the error is raised when the file is written
        return False
    except NotAFileError as error:
        raise JournalError(f"journal {error}") from None
    except UnicodeEncodeError as error:
        raise JournalError(
            f"journal {str(path)!a}: the file system's encoding, {error.encoding}, has no "
            f"{error.object[error.start]!a}; set PYTHONUTF8=1, or name another file"
        ) from None
    except ValueError as error:  # for example, a null character
        raise JournalError(f"journal {str(path)!a}: {error}; name another file") from None
    return True


def _line(entry: dict[str, Any]) -> bytes:
    text = orjson.dumps(entry)
    return b"%08x %s\n" % (zlib.crc32(text), text)


def _is_cut_short(tail: bytes, first: dict[str, Any]) -> bool:
    """Return whether `tail` is the beginning of a first line, with any calling conventions."""
    beginning = orjson.dumps(first | {"calls": None}).removesuffix(b"null}")
    checksum, text = tail[:9], tail[9:]
    known = text.startswith(beginning) or beginning.startswith(text)
    return known and re.fullmatch(rb"[0-9a-f]{0,8}|[0-9a-f]{8} ", checksum) is not None


def _entry(line: bytes) -> dict[str, Any] | None:
    """Contents of a line, or None if it is damaged."""
    try:
        checksum, text = line.split(b" ", 1)
        if int(checksum, 16) != zlib.crc32(text):
            return None
        entry = orjson.loads(text)
    except ValueError:
        return None
    return entry if isinstance(entry, dict) else None


def _value(entry: dict[str, Any] | None) -> tuple[Key, NDArray[np.float64] | Raised]:
    if entry is None:
        raise ValueError
    key = str(entry["task"]), base64.b64decode(entry["theta"])
    if "raised" in entry:
        name, message = entry["raised"]
        return key, Raised(str(name), str(message))
    flat = np.frombuffer(base64.b64decode(entry["value"]), dtype=float)
    return key, flat.reshape(entry["shape"])


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _lock(file: Any, path: str | os.PathLike[str]) -> None:
    """Lock the file for this process; the system unlocks it when the process ends."""
    try:
        import fcntl
    except ImportError:  # not on this system
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if not isinstance(error, BlockingIOError):  # the file system has no locks
            return
        raise JournalError(
            f"journal {path}: another process is writing it; wait for its end, or name another file"
        ) from None
