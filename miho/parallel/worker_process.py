"""The process of a worker, which runs jobs one after the other or each in a fork."""

from __future__ import annotations

import contextlib
import gc
import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from multiprocessing import connection
from types import FrameType
from typing import Any, NoReturn, TypeVar

from miho.parallel.processes import adopt_orphans, child_has_ended, end_child, end_family, end_of
from miho.parallel.remote import Raised

Job = TypeVar("Job")
Result = TypeVar("Result")
Reply = tuple[Result | None, str | None, str | None]
"""A job's result, the reason for having none in one line, and the traceback."""

INTERRUPTED = "interrupted"
"""The reason of an interrupted job."""
POLL = 0.02
"""Seconds between two checks of a job's process, on systems that cannot signal its end."""


def serve(
    work: Callable[[Job], Result],
    prepare: Callable[[Job], object] | None,
    alone: Callable[[Job], bool] | None,
    pipe: connection.Connection,
) -> None:
    """Main loop of a worker: receive a job, send its answer, repeat."""
    if hasattr(os, "fork"):
        os.setsid()
        adopt_orphans()
    threading.Thread(target=_die_with_parent, daemon=True).start()
    # Daemons may have no children, but a job may start workers, which end with it.
    multiprocessing.current_process().daemon = False
    interrupts = _Interrupts()
    while True:
        try:
            signal.signal(signal.SIGINT, interrupts.interrupt)
            job = pipe.recv()
            interrupts.interrupted = False
            pipe.send(None)
            if prepare is not None:
                with contextlib.suppress(Exception):
                    prepare(job)
            if hasattr(os, "fork") and alone is not None and alone(job):
                answer = _run_in_fork(work, job, interrupts)
            else:
                answer = _run_here(work, job, interrupts)
            pipe.send(answer)
        except (OSError, EOFError):  # the parent is gone
            return


class _Interrupts:
    """Records interrupts by the parent and forwards them to the `process` of the current job."""

    def __init__(self) -> None:
        self.interrupted = False
        self.process: int | None = None

    def interrupt(self, number: int, frame: FrameType | None) -> None:
        """Handle SIGINT."""
        self.interrupted = True
        if self.process is not None:
            os.kill(self.process, signal.SIGINT)


def _run_here(work: Callable[[Job], Result], job: Job, interrupts: _Interrupts) -> Reply[Result]:
    """Reply of a job that runs in the worker process."""
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        return (None, INTERRUPTED, None) if interrupts.interrupted else _call(work, job)
    except KeyboardInterrupt:  # between two lines of this function
        return None, INTERRUPTED, None
    finally:
        signal.signal(signal.SIGINT, interrupts.interrupt)


def _run_in_fork(work: Callable[[Job], Result], job: Job, interrupts: _Interrupts) -> Reply[Result]:
    """Reply of a job that runs in a forked process, or the reason why the process ended.

    All processes that the job started are ended with it.
    """
    if interrupts.interrupted:
        return None, INTERRUPTED, None
    receiver, sender = multiprocessing.Pipe(duplex=False)
    alive, life = os.pipe()  # the reading end closes when this process ends
    gc.freeze()  # a collection in the fork would copy memory pages

    # Block SIGINT until the process that it is forwarded to is known.
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    process = os.fork()
    if not process:
        receiver.close()
        os.close(life)
        _run_and_exit(work, job, sender, alive)
    interrupts.process = process
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    sender.close()
    os.close(alive)
    # Wait for the answer or the end of the process, whichever comes first.
    try:
        with end_of(process) as sentinels:
            answer = _receive(receiver, process, sentinels)
    finally:
        interrupts.process = None  # another process may get its number
        status = end_child(process)
        receiver.close()
        os.close(life)
    return answer or (None, exit_reason(os.waitstatus_to_exitcode(status)), None)


def _receive(
    pipe: connection.Connection, process: int, sentinels: Sequence[int]
) -> Reply[Any] | None:
    """The answer that arrives before the process ends, or None."""
    while True:
        connection.wait([pipe, *sentinels], None if sentinels else POLL)
        if pipe.poll():
            try:
                answer: Reply[Any] = pipe.recv()
            except Exception:  # noqa: BLE001 -- cut short by its end, or sent by the job itself
                return None
            return answer
        if child_has_ended(process):
            return None


def _run_and_exit(
    work: Callable[[Job], Result], job: Job, pipe: connection.Connection, alive: int
) -> NoReturn:
    """Run the job in the forked process, send its answer and exit."""
    code = 1
    try:
        os.setpgid(0, 0)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
        threading.Thread(target=_die_with_worker, args=(alive,), daemon=True).start()
        process = os.getpid()
        answer = _call(work, job)
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(Exception):
                stream.flush()
        if os.getpid() == process:  # not a child that the job forked
            pipe.send(answer)
        code = 0
    finally:
        os._exit(code)


def _call(work: Callable[[Job], Result], job: Job) -> Reply[Result]:
    """Reply of a job, including any exception that it raises."""
    try:
        return work(job), None, None
    except KeyboardInterrupt:
        return None, INTERRUPTED, traceback.format_exc()
    except SystemExit as error:
        return None, f"sys.exit({error.code!r})", traceback.format_exc()
    except BaseException as error:  # noqa: BLE001 -- one job's failure must not end the others
        return None, Raised.of(error).line, traceback.format_exc()


def _die_with_parent() -> None:
    """Wait for the end of the parent, then end this process and its descendants."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        end_family(os.getpid())
        os._exit(1)


def _die_with_worker(alive: int) -> None:
    """Wait until the end of the worker closes this pipe, then kill the job's process group."""
    with contextlib.suppress(OSError):
        os.read(alive, 1)
    with contextlib.suppress(OSError):
        os.killpg(0, signal.SIGKILL)
    os._exit(1)


def exit_reason(exitcode: int) -> str:
    """The reason why a process ended without an answer; negative exit codes mean signals."""
    if exitcode >= 0:
        return f"its process ended with exit code {exitcode}"
    name = signal.Signals(-exitcode).name
    return f"killed by {name}" + ", perhaps out of memory" * (name == "SIGKILL")
