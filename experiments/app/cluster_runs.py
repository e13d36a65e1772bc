"""Runs of a sweep on a Dask cluster: the jobs of its workers, and the storage of their results."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from operator import attrgetter
from pathlib import Path

from experiments.app.cluster_workers import ClusterWorkers
from experiments.app.explain import ConfigError
from experiments.app.plan import MODULES, Request, experiment_of
from experiments.app.schema import SweepConfig
from experiments.app.working import State, execute, prepare, with_result
from miho.parallel.cluster import check_address, cluster, dashboard
from miho.parallel.cluster_process import Placed
from miho.parallel.workers import JobOutcome
from miho.study import RunInUse, Status, Store

Delivery = tuple[State, Mapping[str, bytes]]
"""The state of a run, and its files if this machine stores them."""


@contextmanager
def cluster_runs(
    address: str, settings: SweepConfig, *, own_code: bool = False
) -> Iterator[ClusterRuns]:
    """Context with the workers of the cluster at `address`; raises ClusterError.

    Raises ConfigError for runs of the user's code (`own_code`) on machines that do not see it.
    """
    shared = settings.shared or on_this_machine(address)
    if own_code and not shared:
        raise ConfigError(
            "sweep.workers: a file of yours is run, which other machines may not have; put "
            "it and root on a shared file system, and add sweep.shared=true"
        )
    with cluster(address) as client:
        pages = dashboard(client)
        if pages is not None:
            print(f"dashboard {pages} (without a login)", file=sys.stderr)
        here = str(Path.cwd())
        workers: ClusterWorkers[Request, Delivery] = ClusterWorkers(
            client, partial(deliver, here, shared), settings.time_limit, MODULES,
            prepare=partial(prepare_there, here), alone=attrgetter("job.own_code"),
        )  # fmt: skip
        with workers, ClusterRuns(workers, shared=shared) as runs:
            yield runs


def on_this_machine(address: str) -> bool:
    """Whether the workers of a cluster are processes that this machine starts."""
    kind, place = check_address(address)
    return kind == "dask" and isinstance(place, int)


class ClusterRuns:
    """Workers of a cluster with the interface of `Workers`; a context manager.

    A run that is stored here is claimed here while a worker executes it. A run that another process
    has claimed is running elsewhere. The claims end with this process.
    """

    def __init__(self, workers: ClusterWorkers[Request, Delivery], *, shared: bool) -> None:
        self._workers, self._shared = workers, shared
        self._claims: dict[tuple[str, str], ExitStack] = {}
        self._known: deque[JobOutcome[Request, State]] = deque()

    def __enter__(self) -> ClusterRuns:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()

    @property
    def idle(self) -> int:
        """Number of runs that can be started now."""
        return self._workers.idle

    @property
    def busy(self) -> int:
        """Number of runs in execution, or with a known state that `wait` will return."""
        return self._workers.busy + len(self._known)

    @property
    def jobs(self) -> list[Request]:
        """Runs in execution."""
        return self._workers.jobs

    def start(self, request: Request) -> None:
        """Start a run, unless it is stored or another process executes it."""
        store = Store(Path(request.root).absolute())
        if not self._shared:
            with ExitStack() as stack:
                try:
                    stack.enter_context(store.claim(request.identity))
                except RunInUse:
                    self._knows(State(request, Status.RUNNING_ELSEWHERE))
                    return
                result = store.result(request.identity)
                if result is not None:
                    self._knows(with_result(request, Status.DONE_BEFORE, result))
                    return
                self._claims[request.key] = stack.pop_all()
        self._workers.start(replace(request, root=str(store.root)))

    def wait(self, seconds: float) -> list[JobOutcome[Request, State]]:
        """Wait at most `seconds` for a run to end; store and return the runs that have ended."""
        if self._known:
            known = list(self._known)
            self._known.clear()
            return known
        return [self._stored(ended) for ended in self._workers.wait(seconds)]

    def interrupt(self) -> None:
        """Interrupt all runs; `wait` returns their results so far."""
        self._workers.interrupt()

    def kill(self) -> None:
        """Give up all runs."""
        self._workers.kill()
        for claim in self._claims.values():
            claim.close()
        self._claims.clear()

    def _knows(self, state: State) -> None:
        self._known.append(JobOutcome(state.request, state))

    def _stored(self, ended: JobOutcome[Request, Delivery]) -> JobOutcome[Request, State]:
        """Store the files that a worker sent, and return the outcome for the sweep."""
        request = ended.job
        with self._claims.pop(request.key, ExitStack()):
            state, files = ended.result or (None, {})
            if files:
                Store(Path(request.root)).receive(request.identity, files)
            return JobOutcome(request, state, ended.reason, ended.detail, ended.interrupted)


def deliver(folder: str, shared: bool, placed: Placed[Request]) -> Delivery:
    """In a process of a worker: execute a run, in a temporary store unless it sees our files.

    `folder` is the working folder of the sender; `shared` says that the files are the same here.
    """
    request = placed.job
    _go_to(folder)
    _check_same(request)
    if shared:
        return execute(request), {}
    state = execute(replace(request, root=placed.folder))
    # its line may name a file of an unfinished run
    state = replace(state, line=state.line.replace(placed.folder, request.root))
    return state, Store(Path(placed.folder)).files(request.identity)


def prepare_there(folder: str, placed: Placed[Request]) -> None:
    """In a process of a worker: load objects that runs of a user's model share."""
    _go_to(folder)
    prepare(placed.job)


def _go_to(folder: str) -> None:
    """Change to the folder of the sender, if it exists here, so that relative paths agree."""
    with contextlib.suppress(OSError):
        os.chdir(folder)


def _check_same(request: Request) -> None:
    """Raise RuntimeError if the run has another identity on this machine."""
    identity = replace(experiment_of(request.setting).identity, seed=request.identity.seed)
    if identity.id == request.identity.id:
        return
    pairs = {
        "settings": (identity.request, request.identity.request),
        "code": (identity.code, request.identity.code),
        "data": (identity.data, request.identity.data),
        "packages": (dict(identity.packages), dict(request.identity.packages)),
    }
    other = ", ".join(name for name, (here, there) in pairs.items() if here != there)
    raise RuntimeError(
        f"the worker on {socket.gethostname()} has other {other} than the machine of the sweep; "
        "install the same versions there"
    )
