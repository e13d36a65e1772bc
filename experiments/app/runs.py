"""Do the runs of a plan that are not done, here or in other processes, and say how all stand.

It is the one road of a single run, a sweep, a comparison and the parts of a car.
"""

from __future__ import annotations

import sys
import time
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import Any

from tqdm import tqdm

from experiments.app.build import build_optimizer
from experiments.app.execution import error_of, execution_of, line_of, result_line
from experiments.app.mirror import Tracker, check_tracking, mirror
from experiments.app.origin import our_code, packages_of
from experiments.app.plan import MODULES, POLL, Request, dataset_of, experiment_of, setting_of
from experiments.app.schema import SweepConfig
from experiments.app.signals import Stopped, stopping
from miho.identification import CurveFit
from miho.optim.meter import SPURIOUS_INTERRUPT
from miho.optim.minimize import warm_up
from miho.study import Execution, Status, Store, StoredRun, environment_stamp, single_thread
from miho.study.changes import refuse_changes
from miho.study.files import RESULT
from miho.study.manifest import some, write_manifest
from miho.study.redaction import redacted
from miho.study.validity import kernel
from miho.study.workers import Ended, Workers

HERE = 0
"""Processes for runs that are done in this one."""
AGAIN, GRACE = 1.5, 3.5
"""Seconds after the first signal until it is repeated, because Python loses one that strikes in a
callback of a library, and until what still runs is killed, so that all is over in five."""


@dataclass(frozen=True)
class State:
    """What became of a request: a line to print, and why there is no result if there is none.

    `run`: what is stored of it, where this process did it.
    """

    request: Request
    status: Status
    line: str
    error: float | None = None
    reason: str | None = None
    run: StoredRun | None = None


@dataclass
class Runs:
    """How all requests of a plan stand; `stopped` is what ended the work on them early."""

    states: list[State] = field(default_factory=list)
    stopped: KeyboardInterrupt | None = None

    def raise_if_stopped(self) -> None:
        """Raise what stopped them, once what there is to say is printed."""
        if self.stopped is not None:
            raise self.stopped


def run(
    plan: Sequence[Request],
    settings: SweepConfig,
    *,
    processes: int | None = None,
    fresh: bool = False,
    overrides: Sequence[str] = (),
    tracking: Mapping[str, Any] = MappingProxyType({}),
) -> Runs:
    """Do what is not done, `processes` runs at a time (default: `settings.processes`).

    A run that is asked for twice is done once; one that another process is doing is waited for. A
    run that raises, exits, is killed or takes too long is lost alone. After the first signal the
    runs in progress keep what they found and stop, and the states tell how all stand. With `HERE`
    they are done in this process, one after the other, and a failure of one ends none.

    Raises ResumeRefused if finished runs were made of something else. What is finished goes to the
    tracker of `tracking` at the end, unless a signal ended it.
    """
    runs = Runs()
    unique = list({request.identity.id: request for request in plan}.values())
    if settings.dry_run:
        runs.states += [replace(known(request), reason=None) for request in unique]
        return runs
    check_tracking(tracking)
    here = processes == HERE
    # What is there of other code, data or settings is refused before anything begins.
    roots = list(dict.fromkeys(request.root for request in unique))
    for root in roots:
        identities = {r.words: r.identity for r in unique if r.root == root}
        refuse_changes(
            Store(Path(root)), identities, fresh=fresh, overrides=None if here else overrides
        )
        if not here:
            write_manifest(Path(root), overrides, identities)
    at_once = settings.processes if processes is None else processes
    try:
        with _bar(len(unique), at_once) as bar:
            todo: list[Request] = []
            doing = _each_here(todo) if here else _each(todo, settings, at_once)
            for state in chain(_each_known(unique, todo), doing):
                runs.states.append(state)
                bar.show(state)
                if here and state.status is Status.INTERRUPTED:
                    raise KeyboardInterrupt
        mirror_runs(runs.states, tracking)
    except KeyboardInterrupt as stopped:
        seen = {state.request.identity.id for state in runs.states}
        runs.states += [_unread(r) for r in unique if r.identity.id not in seen]
        runs.stopped = stopped
    return runs


def known(request: Request) -> State:
    """What the store knows of a request: it is done, it was tried in vain, or neither."""
    store = Store(Path(request.root))
    result = store.result(request.identity)
    if result is not None:
        return State(request, Status.DONE_BEFORE, f"done before: {request.words}", error_of(result))
    reason = store.reason(request.identity)
    if reason is None:
        return State(request, Status.TO_DO, f"to do: {request.words}")
    return State(request, Status.TO_DO, f"to do again: {request.words}", reason=reason)


def _state(request: Request, execution: Execution) -> State:
    last = (execution.error or "").strip().splitlines()[-1:]
    return State(
        request,
        execution.status,
        line_of(request.identity, execution),
        error_of(None if execution.run is None else execution.run.result),
        last[0] if last else None,
    )


def _unread(request: Request) -> State:
    """What a look at its folder says of a run that was not come to."""
    done = Store(Path(request.root)).has_result(request.identity)
    return State(request, Status.DONE_BEFORE if done else Status.TO_DO, "")


def mirror_runs(states: Sequence[State], tracking: Mapping[str, Any]) -> None:
    """Have the tracker of `tracking`, if there is one, hold what is finished."""
    if not check_tracking(tracking):
        return
    folders: dict[str, list[Path]] = {}
    for state in states:
        store = Store(Path(state.request.root))
        if store.has_result(state.request.identity):
            folder = store.folder(state.request.identity)
            folders.setdefault(state.request.root, []).append(folder)
    for root, finished in folders.items():
        place = Path(root), tracking.get("uri"), tracking.get("experiment")
        mirror(Path(root), finished, partial(_connect, *place))


def _connect(root: Path, uri: str | None, experiment: str | None) -> Tracker:
    from experiments.app.mlflow_tracker import connect  # which few ask for

    return connect(root, uri, experiment)


def _each_known(plan: Sequence[Request], todo: list[Request]) -> Iterator[State]:
    """The runs that need not be done: stored, or lost before they began; `todo` gets the others.

    Says which of those were stored before and have no result now.
    """
    gone = []
    for request in plan:
        store = Store(Path(request.root))
        if request.lost is not None:
            yield ended_state(Ended(request, reason=request.lost))
            continue
        if request.experiment is None:  # what is done in this process looks for itself
            result = store.result(request.identity)
            if result is not None:
                line = result_line(request.identity, result, Status.DONE_BEFORE)
                yield State(request, Status.DONE_BEFORE, line, error_of(result))
                continue
            if store.result_is_gone(request.identity):
                gone.append(request.words)
        todo.append(request)
    if gone:
        print(
            f"{len(gone)} runs were stored before and have no {RESULT} now, because it was deleted "
            f"or their process was killed while it stored them; they run again: {some(gone)}",
            file=sys.stderr,
        )


def _each_here(plan: Sequence[Request]) -> Iterator[State]:
    """The runs as they end, each in this process with a bar of its own."""
    for request in plan:
        execution = execution_of(request.experiment or experiment_of(request.setting))
        yield replace(_state(request, execution), run=execution.run)


def _each(plan: Sequence[Request], settings: SweepConfig, processes: int) -> Iterator[State]:
    """The runs as they end, each in a process of its own."""
    if not plan:
        return
    todo, elsewhere = deque(plan), deque[Request]()
    first = _to_compile(plan) if processes > 1 else None
    with (
        Workers(
            _execute, processes, settings.time_limit, MODULES, prepare=_prepare, alone=_own
        ) as workers,
        stopping(workers) as stop,
    ):
        if first is not None:
            workers.start(first)
        while todo or elsewhere or workers.busy:
            # Once a signal has come, nothing more is started. It is repeated, and in the end what
            # has not stopped is killed.
            if stop.number is not None:
                todo.clear()
                elsewhere.clear()
            if stop.overdue(AGAIN) and not stop.repeated:
                stop.repeated = True
                workers.interrupt()
            if stop.overdue(GRACE):
                left = workers.jobs
                workers.kill()
                for job in left if first is None else ():
                    yield ended_state(Ended(job, reason="did not stop in time", interrupted=True))
                break
            # Idle workers get what is to do; what another process is doing is asked for again.
            while todo and workers.idle and first is None:
                workers.start(todo.popleft())
            if elsewhere and workers.idle:
                time.sleep(POLL)
                todo.append(elsewhere.popleft())
            for ended in workers.wait(POLL) if workers.busy else ():
                if first is not None:
                    first = None
                    continue
                state = ended_state(ended)
                if state.status is Status.RUNNING_ELSEWHERE:
                    elsewhere.append(ended.job)
                    continue
                if state.status in (Status.FAILED, Status.LOST) and settings.stop_on_failure:
                    todo.clear()
                    elsewhere.clear()
                yield state
        if stop.number is not None:
            raise Stopped(stop.number)


def ended_state(ended: Ended[Request, State | None]) -> State:
    """What a worker says, or what is known of a run whose worker says nothing."""
    request, reason, interrupted = ended.job, ended.reason, ended.interrupted
    if ended.result is not None:
        if interrupted or ended.result.status is not Status.INTERRUPTED:
            return replace(ended.result, request=request)
        reason = SPURIOUS_INTERRUPT
    reason = redacted(reason or "no answer")
    status, identity = Status.INTERRUPTED if interrupted else Status.LOST, request.identity
    if ended.result is None:  # else it has kept its curve
        Store(Path(request.root)).keep_reason(identity, reason, ended.detail, str(status))
    who = f"{identity.problem} {identity.optimizer} seed {identity.seed}"
    return State(request, status, f"{who}: {status}: {reason}", reason=reason)


def _own(request: Request) -> bool:
    return request.own


def _prepare(request: Request) -> None:
    """In a worker: what runs of a user's model share, so that each is forked with it."""
    if not request.own:
        return
    with single_thread():
        kernel().recent()
        environment_stamp()
        optimizer = build_optimizer(setting_of(request.setting))
        our_code(frozenset({CurveFit.__module__, type(optimizer).__module__}))
        dataset_of(request.setting)
        packages_of(optimizer)


def _to_compile(plan: Sequence[Request]) -> Request | None:
    """A run whose method is to be compiled before the others start: each would compile the same."""
    by_method = {r.identity.optimizer: r for r in reversed(plan) if not r.own}
    for request in by_method.values():
        if build_optimizer(setting_of(request.setting)).uncompiled:
            if sys.stderr.isatty():
                name = request.identity.optimizer
                print(f"compiling {name}, once on this machine", file=sys.stderr)
            return replace(request, compile_only=True)
    return None


def _execute(request: Request) -> State | None:
    """In a process of its own: do a run, unless it is done; or only compile what it needs."""
    if request.compile_only:
        experiment = experiment_of(request.setting)
        warm_up(experiment.optimizer, experiment.problem)
        return None
    root = Path(request.root).absolute()  # before a model of the user's may change the folder
    experiment = replace(experiment_of(request.setting), identity=request.identity, root=root)
    return _state(request, execution_of(experiment, quiet=True))


@contextmanager
def _bar(total: int, processes: int) -> Iterator[Progress]:
    """A bar on a terminal, else a line for each run; runs in this process have their own bars."""
    if processes == HERE:
        yield Progress(total, processes, None)
        return
    with tqdm(total=total, desc="runs", smoothing=0.02, disable=None) as bar:
        yield Progress(total, processes, bar)


@dataclass
class Progress:
    """What a sweep has done so far."""

    total: int
    processes: int
    bar: Any
    counts: Counter[Status] = field(default_factory=Counter)
    best: dict[str, float] = field(default_factory=dict)

    def show(self, state: State) -> None:
        """Count one run and show where the sweep stands."""
        if self.bar is None:
            return
        self.counts[state.status] += 1
        problem = state.request.identity.problem
        if state.error is not None:
            self.best[problem] = min(state.error, self.best.get(problem, float("inf")))
        bad = self.counts[Status.FAILED] + self.counts[Status.LOST]
        if self.bar.disable:
            print(f"[{self.counts.total()}/{self.total}] {state.line}", flush=True)
            return
        self.bar.update()
        best = "" if len(self.best) != 1 else f", best {next(iter(self.best.values())):.5g}"
        running = min(self.processes, self.total - self.counts.total())
        self.bar.set_postfix_str(f"{running} running, {bad} failed{best}")
        if state.reason is not None:
            self.bar.write(state.line, file=sys.stderr)
