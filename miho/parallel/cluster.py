"""A cluster of Dask by its address: one that runs, one on this machine, or jobs of a queue."""

from __future__ import annotations

import importlib
import importlib.util
import logging
import re
import shutil
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, TypeGuard

from miho.parallel.processes import end_family
from miho.parallel.workers import without_main

if TYPE_CHECKING:
    from distributed import Client

ADDRESSES = "dask://HOST:PORT, dask:N, slurm, slurm:N, pbs:N or lsf:N"
QUEUES = {
    "slurm": ("SLURMCluster", "sbatch"),
    "pbs": ("PBSCluster", "qsub"),
    "lsf": ("LSFCluster", "bsub"),
}
"""The class of dask-jobqueue of each queue, and the program that submits its jobs."""
PATIENCE = 5.0
"""Seconds that a scheduler has to answer: at the start, and when its connection broke."""
LOOK = 10.0
"""Seconds between two looks whether there is any worker."""
LOOPBACK = "127.0.0.1"
SETTINGS = {
    "distributed.comm.timeouts.connect": f"{PATIENCE}s",
    "distributed.scheduler.worker-saturation": "inf",  # a short task waits for no round trip
}
"""What holds in this process while it uses a cluster; the rest is the user's configuration."""


class ClusterError(ValueError):
    """One line: which address, what is wrong with it, and what to do."""


class ClusterLost(RuntimeError):  # noqa: N818 -- what befell, not a mistake
    """The connection to a cluster broke while it was used."""


def is_address(workers: object) -> TypeGuard[str]:
    """Whether this says where workers are, as `cluster` takes it, and not how many."""
    if not isinstance(workers, str):
        return False
    return workers in QUEUES or re.match(r"[a-z]+:", workers) is not None


def check_address(address: str) -> tuple[str, str | int]:
    """The kind of a cluster, and the HOST:PORT of its scheduler or its number of workers or jobs.

    A queue without a number is one job. Raises ClusterError.
    """
    kind, _, place = address.partition(":")
    if address in QUEUES:
        return kind, 1
    if kind == "dask" and re.fullmatch(r"//[^\s/]+:\d{1,5}", place):
        return kind, place[2:]
    if kind in ("dask", *QUEUES) and re.fullmatch(r"[1-9]\d{0,5}", place):
        return kind, int(place)
    raise ClusterError(f"{address!r}: is no address of workers; expected {ADDRESSES}")


@contextmanager
def cluster(address: str) -> Iterator[Client]:
    """Meanwhile a client of the cluster at `address`; what was started for it ends with it.

    `dask://HOST:PORT` is a scheduler that runs. `dask:N` starts N worker processes of one thread on
    this machine, whose connections are encrypted, so that nobody else on it can use them.
    `slurm:N`, `pbs:N` and `lsf:N` submit N jobs, as the user's configuration of dask-jobqueue says;
    they come when the queue lets them; a line on stderr tells of waiting for them. `slurm` is one.

    Raises ClusterError if a library or the program of the queue is missing, nobody answers at the
    address, or a worker that is there has another version of Python, MIHO or Dask.
    """
    kind, place = check_address(address)
    distributed = _library("distributed")
    dask_config = _library("dask.config")
    quiet = distributed.utils.silence_logging_cmgr(logging.CRITICAL, "distributed.client")
    with dask_config.set(SETTINGS), quiet, ExitStack() as stack:
        try:
            if isinstance(place, str):
                scheduler: Any = place
            elif kind == "dask":
                scheduler = stack.enter_context(_local(distributed, place))
            else:
                scheduler = stack.enter_context(_job_queue(kind, place))
            client = stack.enter_context(
                distributed.Client(scheduler, timeout=PATIENCE, set_as_default=False)
            )
            _check_versions(client, address)
        except ClusterError:
            raise
        except OSError as error:
            raise ClusterError(
                f"{address}: no Dask scheduler answers there within {PATIENCE:g} s; start one with "
                f"`dask scheduler`, or correct the address ({_line(error)})"
            ) from None
        except Exception as error:
            raise ClusterError(f"{address}: {_line(error)}") from error
        stack.enter_context(_told_of_emptiness(client, address))
        yield client


@contextmanager
def _told_of_emptiness(client: Any, address: str) -> Iterator[None]:
    """Meanwhile a line on stderr where no worker has come, or all have left."""
    over = threading.Event()

    def watch() -> None:
        empty = False
        while not over.wait(LOOK):
            before, empty = empty, is_empty(client)
            if empty and not before and not over.is_set():
                sys.stderr.write(f"miho: {address}: no worker is there; waiting for one\n")

    threading.Thread(target=watch, daemon=True).start()
    try:
        yield
    finally:
        over.set()


def places(client: Any, address: str) -> int:
    """How many calls its workers make at a time, those included that a queue is still to begin."""
    kind, count = check_address(address)
    if isinstance(count, str):
        return max(1, int(sum(client.ncores().values())))
    return count * int(_queued(kind, "cores")) if kind in QUEUES else count


def is_empty(client: Any) -> bool:
    """Whether no worker is there; a break of the connection shows elsewhere."""
    try:
        return not client.nthreads()
    except Exception:  # noqa: BLE001 -- whatever a library raises whose connection broke
        return False


def dashboard(client: Client) -> str | None:
    """Where a browser sees what the cluster does; None if the library of its pages is missing."""
    return client.dashboard_link if importlib.util.find_spec("bokeh") else None


def dask_setup(worker: object) -> None:
    """Called by Dask in each worker that `dask:N` starts: the terminal's Ctrl-C is not for it.

    The process that has the client decides what becomes of the jobs.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _local(distributed: Any, count: int) -> Iterator[Any]:
    """A cluster of `count` processes on this machine, whose start reruns no main file.

    In the end they are killed with all that they started: nobody waits for anything of theirs, and
    on a busy machine they take seconds to say goodbye.
    """
    with without_main():
        local = distributed.LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            host=LOOPBACK,
            security=True,
            dashboard_address=f"{LOOPBACK}:0",
            silence_logs=logging.CRITICAL,
            preload=[__name__],
        )
    with local:
        try:
            yield local
        finally:
            for nanny in local.workers.values():
                nanny.auto_restart = False
                if nanny.pid is not None:
                    end_family(nanny.pid)


def _job_queue(kind: str, jobs: int) -> Any:
    """A cluster of jobs of a queue."""
    with _own_signals():
        library = _library("dask_jobqueue")
    name, program = QUEUES[kind]
    if shutil.which(program) is None:
        raise ClusterError(
            f"{kind}:{jobs}: there is no program {program} here; start this on a machine that can "
            f"submit jobs, or name a running scheduler by dask://HOST:PORT"
        )
    for key in ("cores", "memory"):
        if _queued(kind, key) is None:
            raise ClusterError(
                f"{kind}:{jobs}: the configuration of dask-jobqueue says nothing of {key}; set "
                f"jobqueue.{kind}.{key}, as in ~/.config/dask/jobqueue.yaml"
            )
    options = {
        "dashboard_address": f"{LOOPBACK}:0",  # any port that is free
        **(_queued(kind, "scheduler-options") or {}),
    }
    queue = getattr(library, name)(scheduler_options=options, silence_logs=logging.CRITICAL)
    queue.scale(jobs=jobs)
    queue.sync(queue._correct_state)
    refused = [job for job in queue.workers.values() if job.status.name == "created"]
    if not refused:
        return queue
    reason = program  # nobody would miss such a job: no error of Dask's tells of it
    try:
        queue.sync(refused[0].start)
    except Exception as error:  # noqa: BLE001 -- whatever the program says
        reason = (str(error).strip().splitlines() or [type(error).__name__])[-1]
    for job in refused:
        job.status = type(job.status)["failed"]
    queue.close()
    raise ClusterError(f"{kind}:{jobs}: {program} refuses the job: {reason}")


def _queued(kind: str, key: str) -> Any:
    """What the user's configuration says of the jobs of a queue."""
    return _library("dask.config").get(f"jobqueue.{kind}.{key}", None)


@contextmanager
def _own_signals() -> Iterator[None]:
    """What Ctrl-C does stays as it is, whatever a library does when it is imported."""
    handler = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, handler)


def _library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise ClusterError(
            f"a cluster needs the extra cluster: pip install miho[cluster] ({error})"
        ) from None


def versions() -> dict[str, str]:
    """What has to be the same in a client and its workers."""
    from importlib import metadata  # only here: it is slow to import

    libraries = {name: metadata.version(name) for name in ("distributed", "cloudpickle")}
    try:
        ours = metadata.version("miho")
    except metadata.PackageNotFoundError:
        ours = "of a checkout"
    return {"Python": "{}.{}".format(*sys.version_info), "miho": ours, **libraries}


def _check_versions(client: Client, address: str) -> None:
    """Refuse a worker that is there and could not do the same as this process."""
    here = versions()
    for worker, there in client.run(versions, on_error="return").items():
        if isinstance(there, (ImportError, AttributeError)):
            raise ClusterError(
                f"{address}: the worker {worker} cannot import miho {here['miho']} ({_line(there)})"
                "; start it where this version is installed"
            )
        if isinstance(there, BaseException):  # it left
            continue
        for name, version in here.items():
            if there.get(name) != version:
                raise ClusterError(
                    f"{address}: the worker {worker} has {name} {there.get(name)}, this process "
                    f"{version}; start it with the same version"
                )


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
