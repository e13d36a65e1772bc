"""Connect to a Dask cluster by its address: a scheduler, local workers or a batch queue."""

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
"""For each batch queue the class of dask-jobqueue and the program that submits jobs."""
PATIENCE = 5.0
"""Seconds within which a scheduler must answer, at the start and after its connection broke."""
LOOK = 10.0
"""Seconds between two checks for workers."""
LOOPBACK = "127.0.0.1"
SETTINGS = {
    "distributed.comm.timeouts.connect": f"{PATIENCE}s",
    "distributed.scheduler.worker-saturation": "inf",  # short tasks do not wait for a round trip
}
"""Dask settings of this process while it uses a cluster; others keep the user's values."""


class ClusterError(ValueError):
    """A cluster cannot be used; the message names the address, the fault and a remedy."""


class ClusterLost(RuntimeError):  # noqa: N818 -- an event, not a mistake
    """The connection to a cluster broke during use."""


def is_address(workers: object) -> TypeGuard[str]:
    """Return whether `workers` is an address that `cluster` accepts, not a number of workers."""
    if not isinstance(workers, str):
        return False
    return workers in QUEUES or re.match(r"[a-z]+:", workers) is not None


def check_address(address: str) -> tuple[str, str | int]:
    """Return the kind of a cluster, and its scheduler's HOST:PORT or its number of workers or jobs.

    A queue without a number means one job. Raises ClusterError for an invalid address.
    """
    kind, _, place = address.partition(":")
    if address in QUEUES:
        return kind, 1
    if kind == "dask" and re.fullmatch(r"//[^\s/]+:\d{1,5}", place):
        return kind, place[2:]
    if kind in ("dask", *QUEUES) and re.fullmatch(r"[1-9]\d{0,5}", place):
        return kind, int(place)
    raise ClusterError(f"{address!r}: not an address of workers; expected {ADDRESSES}")


@contextmanager
def cluster(address: str) -> Iterator[Client]:
    """Context manager of a client of the cluster at `address`.

    Resources that it starts end with the context.

    Parameters
    ----------
    address : str
        ``dask://HOST:PORT`` is a running scheduler. ``dask:N`` starts N single-threaded worker
        processes on this machine, with encrypted connections, so that other users of the
        machine cannot use them. ``slurm:N``, ``pbs:N`` and ``lsf:N`` submit N jobs, configured by
        the user's settings of dask-jobqueue; ``slurm`` alone means one job. A line on stderr
        reports when no worker is available.

    Raises
    ------
    ClusterError
        If a library or the queue's program is missing, the scheduler does not answer, or a
        connected worker has another version of Python, MIHO or Dask.
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
    """Write a line to stderr whenever no worker is available."""
    over = threading.Event()

    def watch() -> None:
        empty = False
        while not over.wait(LOOK):
            before, empty = empty, is_empty(client)
            if empty and not before and not over.is_set():
                sys.stderr.write(f"miho: {address}: no workers are available; waiting for one\n")

    threading.Thread(target=watch, daemon=True).start()
    try:
        yield
    finally:
        over.set()


def places(client: Any, address: str) -> int:
    """Number of calls that the workers make at a time, including workers that are still queued."""
    kind, count = check_address(address)
    if isinstance(count, str):
        return max(1, int(sum(client.ncores().values())))
    return count * int(_queued(kind, "cores")) if kind in QUEUES else count


def is_empty(client: Any) -> bool:
    """Return whether the cluster has no workers. Other code detects a broken connection."""
    try:
        return not client.nthreads()
    except Exception:  # noqa: BLE001 -- any error of a broken connection
        return False


def dashboard(client: Client) -> str | None:
    """URL of the cluster's dashboard, or None if Bokeh, which draws it, is missing."""
    return client.dashboard_link if importlib.util.find_spec("bokeh") else None


def dask_setup(worker: object) -> None:
    """Ignore Ctrl-C in the workers that `dask:N` starts; Dask calls this in each of them.

    The client's process decides how jobs end.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _local(distributed: Any, count: int) -> Iterator[Any]:
    """Start `count` worker processes on this machine without running the main file again.

    At the end the workers and their descendants are killed: their shutdown would take seconds on a
    busy machine.
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
    """Submit jobs to a batch queue and return their cluster."""
    handler = signal.getsignal(signal.SIGINT)  # of Ctrl-C, which the import may replace
    try:
        library = _library("dask_jobqueue")
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, handler)
    name, program = QUEUES[kind]
    if shutil.which(program) is None:
        raise ClusterError(
            f"{kind}:{jobs}: this machine has no program {program}; start this on a machine that "
            f"can submit jobs, or give a running scheduler as dask://HOST:PORT"
        )
    for key in ("cores", "memory"):
        if _queued(kind, key) is None:
            raise ClusterError(
                f"{kind}:{jobs}: the configuration of dask-jobqueue has no {key}; set "
                f"jobqueue.{kind}.{key}, for example in ~/.config/dask/jobqueue.yaml"
            )
    options = {
        "dashboard_address": f"{LOOPBACK}:0",  # any free port
        **(_queued(kind, "scheduler-options") or {}),
    }
    queue = getattr(library, name)(scheduler_options=options, silence_logs=logging.CRITICAL)
    queue.scale(jobs=jobs)
    queue.sync(queue._correct_state)
    refused = [job for job in queue.workers.values() if job.status.name == "created"]
    if not refused:
        return queue
    reason = program  # Dask does not report such a job
    try:
        queue.sync(refused[0].start)
    except Exception as error:  # noqa: BLE001 -- any error of the program
        reason = (str(error).strip().splitlines() or [type(error).__name__])[-1]
    for job in refused:
        job.status = type(job.status)["failed"]
    queue.close()
    raise ClusterError(f"{kind}:{jobs}: {program} refuses the job: {reason}")


def _queued(kind: str, key: str) -> Any:
    """Setting `key` of the queue's jobs in the user's Dask configuration, or None."""
    return _library("dask.config").get(f"jobqueue.{kind}.{key}", None)


def _library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise ClusterError(
            f"a cluster needs the extra cluster: pip install miho[cluster] ({error})"
        ) from None


def versions() -> dict[str, str]:
    """Versions that must agree between a client and its workers."""
    from importlib import metadata  # only here: it is slow to import

    libraries = {name: metadata.version(name) for name in ("distributed", "cloudpickle")}
    try:
        ours = metadata.version("miho")
    except metadata.PackageNotFoundError:
        ours = "of a checkout"
    return {"Python": "{}.{}".format(*sys.version_info), "miho": ours, **libraries}


def _check_versions(client: Client, address: str) -> None:
    """Refuse workers whose versions differ from the versions of this process."""
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
