"""Do the runs of a plan that are not done, in this process or in workers; the state of all.

Single runs, sweeps, comparisons and the parts of a car are all done here.
"""

from __future__ import annotations

import sys
import time
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import Any

from tqdm import tqdm

from experiments.app.build import build_optimizer
from experiments.app.execution import execution_of, line_of, result_error, result_line
from experiments.app.mirror import check_tracking, mirror_runs, say_unmirrored
from experiments.app.origin import our_code, packages_of
from experiments.app.plan import MODULES, POLL, Request, dataset_of, experiment_of, setting_of
from experiments.app.schema import SweepConfig
from experiments.app.signals import Stopped, stopping
from miho.identification import CurveFit
from miho.optim.minimize import warm_up
from miho.parallel.worker_process import SPURIOUS_INTERRUPT
from miho.parallel.workers import JobOutcome, Workers
from miho.study import Execution, Status, Store, StoredRun, environment_stamp, single_thread
from miho.study.changes import refuse_changes
from miho.study.contention import reference_work
from miho.study.files import RESULT
from miho.study.manifest import first_names, write_manifest
from miho.study.redaction import redacted

HERE = 0
"""Processes for runs that are done in this one."""
REPEAT_AFTER, KILL_AFTER = 1.5, 3.5
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
class PlanOutcome:
    """The states of all requests of a plan; `stopped` is the interrupt that ended it early."""

    states: list[State] = field(default_factory=list)
    stopped: KeyboardInterrupt | None = None

    def raise_if_stopped(self) -> None:
        """Raise the interrupt, to be called after the states are printed."""
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
) -> PlanOutcome:
    """Do what is not done, `processes` runs at a time (default: `settings.processes`).

    A run that is asked for twice is done once; one that another process is doing is waited for. A
    run that raises, exits, is killed or takes too long is lost alone. After the first signal the
    runs in progress keep what they found and stop, and the states tell how all stand. With `HERE`
    they are done in this process, one after the other, and a failure of one ends none.

    Raises ResumeRefused if finished runs were made of something else. What is finished goes to the
    tracker of `tracking` at the end, unless a signal ended it.
    """
    runs = PlanOutcome()
    unique = list({request.identity.id: request for request in plan}.values())
    if settings.dry_run:
        runs.states += [replace(stored_state(request), reason=None) for request in unique]
        return runs
    check_tracking(tracking)
    at_once = settings.processes if processes is None else processes
    _refuse_and_list(unique, overrides, fresh=fresh, in_process=at_once == HERE)
    try:
        try:
            _do(unique, settings, at_once, runs.states)
        except KeyboardInterrupt:
            say_unmirrored(unique, tracking)
            raise
        mirror_runs(unique, tracking)
    except KeyboardInterrupt as stopped:
        known = {state.request.identity.id for state in runs.states}
        runs.states += [_state_after_stop(r) for r in unique if r.identity.id not in known]
        runs.stopped = stopped
    return runs


def _refuse_and_list(
    plan: Sequence[Request], overrides: Sequence[str], *, fresh: bool, in_process: bool
) -> None:
    """Refuse, before anything begins, what is stored of other code, data or settings.

    A sweep is also written down in each of its roots, so that runs that go missing are missed.
    """
    for root in dict.fromkeys(request.root for request in plan):
        identities = {r.words: r.identity for r in plan if r.root == root}
        words = None if in_process else overrides
        refuse_changes(Store(Path(root)), identities, fresh=fresh, overrides=words)
        if not in_process:
            write_manifest(Path(root), overrides, identities)


def _do(
    plan: Sequence[Request], settings: SweepConfig, processes: int, states: list[State]
) -> None:
    """Go through a plan and append the state of each request as soon as it is known."""
    in_process = processes == HERE
    with _bar(len(plan), processes) as bar:
        todo: list[Request] = []
        executed = _run_here(todo) if in_process else _run_in_workers(todo, settings, processes)
        for state in chain(_stored_states(plan, todo), executed):
            states.append(state)
            bar.show(state)
            if in_process and state.status is Status.INTERRUPTED:
                raise KeyboardInterrupt


def stored_state(request: Request) -> State:
    """The state of a request by the store alone: it is done, it was tried in vain, or neither."""
    store = Store(Path(request.root))
    result = store.result(request.identity)
    if result is not None:
        line, error = f"done before: {request.words}", result_error(result)
        return State(request, Status.DONE_BEFORE, line, error)
    reason = store.reason(request.identity)
    if reason is None:
        return State(request, Status.TO_DO, f"to do: {request.words}")
    return State(request, Status.TO_DO, f"to do again: {request.words}", reason=reason)


def _executed_state(request: Request, execution: Execution) -> State:
    last = (execution.error or "").strip().splitlines()[-1:]
    return State(
        request,
        execution.status,
        line_of(request.identity, execution),
        result_error(None if execution.run is None else execution.run.result),
        last[0] if last else None,
    )


def _state_after_stop(request: Request) -> State:
    """The state of a run that was not begun before a signal, from a look at its folder."""
    stored = Store(Path(request.root)).has_result(request.identity)
    return State(request, Status.DONE_BEFORE if stored else Status.TO_DO, "")


def _stored_states(plan: Sequence[Request], todo: list[Request]) -> Iterator[State]:
    """The runs that need not be done: stored, or lost before they began; `todo` gets the others.

    Prints which of the others were stored before and have no result now.
    """
    deleted = []
    for request in plan:
        store = Store(Path(request.root))
        if request.lost is not None:
            yield ended_state(JobOutcome(request, reason=request.lost))
            continue
        if request.experiment is None:  # what is done in this process looks for itself
            result = store.result(request.identity)
            if result is not None:
                line = result_line(request.identity, result, Status.DONE_BEFORE)
                yield State(request, Status.DONE_BEFORE, line, result_error(result))
                continue
            if store.lost_result(request.identity):
                deleted.append(request.words)
        todo.append(request)
    if deleted:
        print(
            f"{len(deleted)} runs were stored before and have no {RESULT} now, because it was "
            "deleted or their process was killed while it stored them; they run again: "
            f"{first_names(deleted)}",
            file=sys.stderr,
        )


def _run_here(plan: Sequence[Request]) -> Iterator[State]:
    """The runs as they end, each in this process with a bar of its own."""
    for request in plan:
        execution = execution_of(request.experiment or experiment_of(request.setting))
        yield replace(_executed_state(request, execution), run=execution.run)


def _run_in_workers(
    plan: Sequence[Request], settings: SweepConfig, processes: int
) -> Iterator[State]:
    """The runs as they end, each in a process of its own."""
    if not plan:
        return
    todo, elsewhere = deque(plan), deque[Request]()
    first = _to_compile(plan) if processes > 1 else None
    with (
        Workers(
            _execute,
            processes,
            settings.time_limit,
            MODULES,
            prepare=_prepare,
            alone=_own_code,
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
            if stop.overdue(REPEAT_AFTER) and not stop.repeated:
                stop.repeated = True
                workers.interrupt()
            if stop.overdue(KILL_AFTER):
                unstopped = workers.jobs
                workers.kill()
                for job in unstopped if first is None else ():
                    reason = "did not stop in time"
                    yield ended_state(JobOutcome(job, reason=reason, interrupted=True))
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


def ended_state(ended: JobOutcome[Request, State | None]) -> State:
    """The state that a worker gives, or that of a run whose worker ended without one."""
    request, reason, interrupted = ended.job, ended.reason, ended.interrupted
    if ended.result is not None:
        if interrupted or ended.result.status is not Status.INTERRUPTED:
            return replace(ended.result, request=request)
        reason = SPURIOUS_INTERRUPT
    reason = redacted(reason or "no answer")
    status, identity = Status.INTERRUPTED if interrupted else Status.LOST, request.identity
    if ended.result is None:  # else it has kept its curve
        Store(Path(request.root)).keep_reason(identity, reason, ended.detail, str(status))
    name = f"{identity.problem} {identity.optimizer} seed {identity.seed}"
    return State(request, status, f"{name}: {status}: {reason}", reason=reason)


def _own_code(request: Request) -> bool:
    return request.own_code


def _prepare(request: Request) -> None:
    """In a worker: load what runs of a user's model share, before each is forked from it."""
    if not request.own_code:
        return
    with single_thread():
        reference_work().recent()
        environment_stamp()
        optimizer = build_optimizer(setting_of(request.setting))
        our_code(frozenset({CurveFit.__module__, type(optimizer).__module__}))
        dataset_of(request.setting)
        packages_of(optimizer)


def _to_compile(plan: Sequence[Request]) -> Request | None:
    """A run whose method is to be compiled before the others start: each would compile the same."""
    by_method = {r.identity.optimizer: r for r in reversed(plan) if not r.own_code}
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
    return _executed_state(request, execution_of(experiment, quiet=True))


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
