"""Commands as a user types them, each in a process of its own that starts in milliseconds.

It is forked from one that has imported what the commands need: from this one (`begun`), a row's own
with one thread, or from a fresh interpreter in other surroundings (`called`), which is

    python -m tests.faults.commands < calls.json

The workers of sweeps come from one server of this process, where each command has its own.
"""

from __future__ import annotations

import ctypes
import datetime
import importlib
import json
import os
import runpy
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cache, partial
from multiprocessing import forkserver, util
from pathlib import Path
from typing import IO
from unittest import mock

from experiments.app.compose import composed
from experiments.app.plan import MODULES, requests
from miho.parallel.workers import start_server

CHECKOUT = Path(__file__).parents[2]
TINY = ("optimizer=random", "budget.evaluations=200", "dataset.n=40")
"""A method, a budget and data that take a millisecond."""
DEADLINE = 140.0


@dataclass(frozen=True)
class Call:
    """A command and what is wrong with its surroundings.

    `files` are written just before, by their paths. A `plain` user may write only where
    permissions say so, even one that is root. `now` is what the clock says in seconds since 1970,
    `fsync` the error number with which each fsync fails.
    """

    arguments: list[str]
    command: str = "experiments.identify"
    environment: dict[str, str] = field(default_factory=dict)
    plain: bool = False
    now: float | None = None
    fsync: int | None = None
    files: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Ended:
    """How a command ended: its exit code and what it printed."""

    code: int
    out: str
    err: str

    @property
    def complaint(self) -> str:
        """What it printed on standard error that begins with "error:", or a traceback's head."""
        lines = [line for line in self.err.splitlines() if line.startswith(("error:", "Trace"))]
        return "\n".join(lines)


@dataclass(frozen=True)
class Begun:
    """A command in progress, and what it prints."""

    pid: int
    out: IO[bytes]
    err: IO[bytes]

    def end(self) -> Ended:
        """Wait for its end; how it was."""
        code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        texts = []
        for stream in (self.out, self.err):
            stream.seek(0)
            texts.append(stream.read().decode("utf-8", "backslashreplace"))
            stream.close()
        return Ended(code, *texts)


def begun(call: Call) -> Begun:
    """Start the command in a session of its own, forked from this process."""
    if "-m" in call.arguments:
        serve_workers()
    for path, text in call.files.items():
        Path(path).write_text(text, encoding="utf-8")
    return forked(partial(_command, call))


def forked(job: Callable[[], object]) -> Begun:
    """Start `job` in a session of its own, forked from this process; what it exits with counts."""
    streams = tempfile.TemporaryFile(), tempfile.TemporaryFile()  # noqa: SIM115 -- see end
    pid = os.fork()
    if not pid:
        for stream, descriptor in zip(streams, (1, 2), strict=True):
            os.dup2(stream.fileno(), descriptor)
        _become(job)
    return Begun(pid, *streams)


def identified(*arguments: str) -> Ended:
    """How `python -m experiments.identify` with these arguments ended, forked from this process."""
    return begun(Call(list(arguments))).end()


@cache
def prepare() -> None:
    """Serve workers, and find here what forks would find each: the digest of the code above all."""
    serve_workers()
    requests(composed([]), "", [0])


@cache
def serve_workers() -> None:
    """Start the server of workers, which the forks of this process share."""
    start_server(MODULES)


def called(
    calls: Iterable[Call],
    environment: Mapping[str, str] | None = None,
    checkout: Path = CHECKOUT,
) -> list[Ended]:
    """Run the commands one after the other, in this `environment` if it is given."""
    described = json.dumps([asdict(call) for call in calls])
    process = subprocess.run(
        [sys.executable, "-m", "tests.faults.commands"],
        input=described, capture_output=True, encoding="utf-8", check=False, cwd=checkout,
        env=environment, timeout=DEADLINE,
    )  # fmt: skip
    if process.returncode:
        raise RuntimeError(process.stderr)
    return [Ended(**ended) for ended in json.loads(process.stdout)]


def _command(call: Call) -> None:
    os.environ.update(call.environment)
    if call.fsync is not None:
        mock.patch("os.fsync", _failing(call.fsync)).start()
    if call.now is not None:
        _set_clock(call.now)
    if call.plain:
        _drop_capabilities()
    sys.argv = [call.command, *call.arguments]
    sys.modules.pop(call.command, None)
    runpy.run_module(call.command, run_name="__main__")


def _become(job: Callable[[], object]) -> None:
    """Let this process do the job and end; does not return."""
    code = 1
    try:
        os.setsid()
        sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # as in a terminal, also below nohup
        if serve_workers.cache_info().currsize:  # which our parent alone may wait for
            mock.patch.object(forkserver, "ensure_running").start()
            mock.patch.object(forkserver._forkserver, "ensure_running").start()
        job()
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:  # noqa: BLE001 -- shown as a command shows it
        traceback.print_exc()
    finally:
        util._exit_function()  # type: ignore[attr-defined]  # as every process of multiprocessing ends
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _failing(error: int) -> Callable[[object], None]:
    def fsync(_: object) -> None:
        raise OSError(error, os.strerror(error))

    return fsync


def _drop_capabilities() -> None:
    """Give up the right of root on Linux to ignore permissions; see capset(2)."""
    library = ctypes.CDLL(None)
    version_3 = 0x20080522
    header, none = (ctypes.c_uint32 * 2)(version_3, 0), (ctypes.c_uint32 * 6)()
    if sys.platform == "linux" and library.capset(header, none):
        raise PermissionError("capabilities cannot be dropped")


def _set_clock(now: float) -> None:
    """Let the wall clock of this process go on from `now`."""
    importlib.import_module("pandas")  # whose compiled parts must meet datetime as it is
    behind = time.time_ns() / 1e9 - now
    real_time, real_datetime = time.time, datetime.datetime

    class Behind(real_datetime):  # type: ignore[misc, valid-type]
        @classmethod
        def now(cls, tz: datetime.tzinfo | None = None) -> datetime.datetime:
            return real_datetime.fromtimestamp(real_time() - behind, tz)

    time.time = lambda: real_time() - behind
    datetime.datetime = Behind  # type: ignore[misc]


def started(*arguments: str) -> subprocess.Popen[bytes]:
    """`python -m experiments.identify` in a session of its own, from a fresh interpreter."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.Popen(
        [sys.executable, "-m", "experiments.identify", *arguments],
        cwd=CHECKOUT,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def descendants(pid: int) -> list[int]:
    """Processes that stem from this one and have not ended, by what /proc says."""
    parents: dict[int, int] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text(encoding="utf-8").rpartition(")")[2].split()
        except OSError:
            continue
        if fields[0] != "Z":
            parents[int(stat.parent.name)] = int(fields[1])
    found, open_ones = [], [pid]
    while open_ones:
        children = [child for child, parent in parents.items() if parent == open_ones[0]]
        found += children
        open_ones = [*open_ones[1:], *children]
    return found


def alive(pids: list[int]) -> list[int]:
    """Those that have not ended."""
    found = []
    for pid in pids:
        try:
            stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
        except OSError:
            continue
        if stat.rpartition(")")[2].split()[0] != "Z":
            found.append(pid)
    return found


if __name__ == "__main__":
    json.dump([asdict(begun(Call(**call)).end()) for call in json.load(sys.stdin)], sys.stdout)
