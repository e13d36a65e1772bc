"""Commands as a user types them, each in a process of its own that starts in milliseconds.

    python -m experiments.faults.called < calls.json

imports what the commands need once and forks for each call.
"""

from __future__ import annotations

import ctypes
import datetime
import json
import os
import runpy
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from unittest import mock

import experiments.run  # noqa: F401 -- the forks find it imported

CHECKOUT = Path(__file__).parent.parent.parent
DEADLINE = 100.0


@dataclass(frozen=True)
class Call:
    """A command and what is wrong with its surroundings.

    A `plain` user may write only where permissions say so, even one that is root. `now` is what
    the clock says in seconds since 1970, `fsync` the error number with which each fsync fails.
    """

    arguments: list[str]
    command: str = "experiments.identify"
    environment: dict[str, str] = field(default_factory=dict)
    plain: bool = False
    now: float | None = None
    fsync: int | None = None


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


def called(calls: Iterable[Call], environment: Mapping[str, str] | None = None) -> list[Ended]:
    """Run the commands one after the other, in this `environment` if it is given."""
    given = json.dumps([asdict(call) for call in calls])
    told = subprocess.run(
        [sys.executable, "-m", "experiments.faults.called"],
        input=given, capture_output=True, encoding="utf-8", check=False, cwd=CHECKOUT,
        env=environment, timeout=DEADLINE,
    )  # fmt: skip
    if told.returncode:
        raise RuntimeError(told.stderr)
    return [Ended(**ended) for ended in json.loads(told.stdout)]


def _forked(call: Call) -> Ended:
    pipes = [os.pipe() for _ in range(2)]
    child = os.fork()
    if not child:
        for (_, write), descriptor in zip(pipes, (1, 2), strict=True):
            os.dup2(write, descriptor)
        _become(call)
    for _, write in pipes:
        os.close(write)
    texts = []
    for read, _ in pipes:  # what a command prints is far less than a pipe holds
        with os.fdopen(read, encoding="utf-8", errors="backslashreplace") as stream:
            texts.append(stream.read())
    return Ended(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), *texts)


def _become(call: Call) -> None:
    """Turn this process into the command; does not return."""
    code = 1
    try:
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
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:  # noqa: BLE001 -- shown as a command shows it
        traceback.print_exc()
    finally:
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
    behind = time.time_ns() / 1e9 - now
    real_time, real_datetime = time.time, datetime.datetime

    class Behind(real_datetime):  # type: ignore[misc, valid-type]
        @classmethod
        def now(cls, tz: datetime.tzinfo | None = None) -> datetime.datetime:
            return real_datetime.fromtimestamp(real_time() - behind, tz)

    time.time = lambda: real_time() - behind
    datetime.datetime = Behind  # type: ignore[misc]


if __name__ == "__main__":
    print(json.dumps([asdict(_forked(Call(**call))) for call in json.load(sys.stdin)]))
