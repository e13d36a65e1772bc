"""A sweep: the runs that are wanted, each done once in worker processes, and how they ended."""

from __future__ import annotations

import math
import signal
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from itertools import chain
from pathlib import Path
from types import FrameType, MappingProxyType
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf
from tqdm import tqdm

from experiments import schema
from experiments.build import (
    ConfigError,
    Experiment,
    build,
    build_dataset,
    build_optimizer,
    build_problem,
    our_code,
    packages_of,
)
from experiments.explain import one_line
from experiments.manifest import refuse_other_settings, some, write_manifest
from experiments.mirror import Mirror, open_mirror
from experiments.own_code import code_of, named_only, runs_own_code
from experiments.run import line, result_line, run
from experiments.stopped import HANG_UP, Stopped, ignores_hang_up
from miho.data import Dataset
from miho.identification import CurveFit
from miho.optim.minimize import warm_up
from miho.optim.oracle import UNSENT
from miho.study import Identity, Status, Store, environment_stamp, single_thread
from miho.study.changes import refuse_changes
from miho.study.files import RESULT
from miho.study.redaction import redacted
from miho.study.validity import kernel
from miho.study.workers import Ended, Workers

PROBLEM = ("model", "dataset", "space", "loss", "problem")
AGAIN, GRACE = 1.5, 3.5
"""Seconds after the first signal until it is repeated, because Python loses one that strikes in a
callback of a library, and until what still runs is killed, so that all is over in five."""
POLL = 0.2
MODULES = ("experiments.sweep",)
HOW = ("fresh", "sweep", "tracking")
"""What says how to go through runs, but not what they are."""
SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGUSR1", "SIGHUP")
                if hasattr(signal, name))  # fmt: skip


@dataclass(frozen=True)
class Wanted:
    """One run: what was asked in the user's words, its configuration in YAML, and who it is.

    `own`: its model is code of the user's. `lost`: why it cannot even begin. `compile_only`: it is
    not done, but what it needs is compiled.
    """

    asked: str
    setting: str
    identity: Identity
    root: str
    own: bool = False
    lost: str | None = None
    compile_only: bool = False


@dataclass(frozen=True)
class Done:
    """What became of a wanted run: a line to print, and why there is no result if there is none."""

    wanted: Wanted
    status: Status
    line: str
    error: float | None = None
    reason: str | None = None


@dataclass
class Stop:
    """Which signal asked the sweep to stop, and when."""

    number: int | None = None
    at: float = 0.0
    repeated: bool = False

    def overdue(self, seconds: float) -> bool:
        """Whether the runs had so many seconds to stop."""
        return self.number is not None and time.monotonic() > self.at + seconds


def wanted(
    cfg: DictConfig, asked: str, seeds: Sequence[int], time_limit: float | None = None
) -> list[Wanted]:
    """The runs of one configuration with several seeds; raises ConfigError for a bad one.

    A model of the user's is tried in a process of its own, within the time limit of a run, by
    default that of the configuration: what ends that process loses these runs alone.
    """
    for seed in seeds:
        if seed < 0:
            raise ConfigError(f"seed: is {seed}; expected a whole number of at least 0")
    setting, own, lost = OmegaConf.to_yaml(cfg), runs_own_code(cfg), None
    if own:
        limit = cfg.sweep.time_limit if time_limit is None else time_limit
        what = OmegaConf.masked_copy(cfg, [str(key) for key in cfg if key not in HOW])
        identity, lost = _tried(OmegaConf.to_yaml(what), code_of(cfg), limit)
    else:
        identity = build(cfg, _problem(_of_problem(cfg))).identity
    return [
        Wanted(f"{asked} seed={seed}".strip(), setting, replace(identity, seed=seed),
               str(cfg.root), own, lost)
        for seed in seeds
    ]  # fmt: skip


@cache
def _tried(setting: str, code: str, time_limit: float | None) -> tuple[Identity, str | None]:
    """Who a run of the user's model is; or, with the reason, who it would be if it could be tried.

    `code` is that of the model, so that what is tried once is tried again after an edit. Raises
    ConfigError for what the user can correct.
    """
    with Workers(_identity, 1, time_limit, MODULES, alone=bool) as workers:
        workers.start(setting)
        ended: list[Ended[str, Identity | str]] = []
        while not ended:
            ended = workers.wait(POLL)
    found = ended[0].result
    if isinstance(found, str):
        raise ConfigError(found)
    if found is not None:
        return found, None
    return named_only(_read(setting), code), ended[0].reason


def _identity(setting: str) -> Identity | str:
    """In a worker: who a run of this setting is, or what is wrong with the setting."""
    try:
        return build(_read(setting)).identity
    except Exception as error:  # noqa: BLE001 -- whatever the user's file raises, they can correct
        return one_line(error)


def sweep(
    runs: Sequence[Wanted],
    settings: schema.SweepConfig,
    *,
    fresh: bool = False,
    overrides: Sequence[str] = (),
    tracking: Mapping[str, Any] = MappingProxyType({}),
    ended: list[Done] | None = None,
) -> list[Done]:
    """Do the runs that are not done, `settings.processes` at a time, and say what became of all.

    A run that is wanted twice is done once; one that another process is doing is waited for. A run
    that raises, exits, is killed or takes too long is lost alone. After the first signal the runs
    in progress keep what they found and stop; raises Stopped then, and `ended`, which gets what it
    returns, holds how all runs stand. Raises ResumeRefused if finished runs were made of something
    else. What is finished goes to the tracker of `tracking` as well.
    """
    ended = [] if ended is None else ended
    unique = list({one.identity.id: one for one in runs}.values())
    roots = {one.root for one in unique}
    if settings.dry_run:
        ended += [replace(found(one), reason=None) for one in unique]
        return ended
    for root in roots:
        mine = {one.asked: one.identity for one in unique if one.root == root}
        refuse_other_settings(Path(root), overrides, mine, fresh=fresh)
        refuse_changes(Store(Path(root)), mine.values(), fresh=fresh)
        write_manifest(Path(root), overrides, mine)
    with mirrors(roots, tracking) as opened, _bar(len(unique), settings.processes) as bar:
        try:
            todo: list[Wanted] = []
            for done in chain(_each_known(unique, todo), _each(todo, settings)):
                ended.append(done)
                bar.tell(done)
                _push(opened.get(done.wanted.root), done.wanted)
        except Stopped:
            known = {done.wanted.identity.id for done in ended}
            ended += [_unread(one) for one in unique if one.identity.id not in known]
            raise
    return ended


def _push(mirror: Mirror | None, one: Wanted) -> None:
    stored = Store(Path(one.root)).find(one.identity) if mirror else None
    if mirror and stored:
        mirror.push(stored)


def _unread(one: Wanted) -> Done:
    """What a look at its folder says of a run that a sweep did not come to."""
    there = Store(Path(one.root)).has_result(one.identity)
    return Done(one, Status.DONE_BEFORE if there else Status.TO_DO, "")


@contextmanager
def mirrors(roots: Iterable[str], tracking: Mapping[str, Any]) -> Iterator[dict[str, Mirror]]:
    """A mirror for each root, if there is a tracker; they get some seconds to finish."""
    all_of = {root: open_mirror(Path(root), **tracking) for root in roots} if tracking else {}
    opened = {root: mirror for root, mirror in all_of.items() if mirror is not None}
    seconds = 1.0
    try:
        yield opened
        seconds = 10.0
    finally:
        for mirror in opened.values():
            mirror.close(seconds)


def found(one: Wanted) -> Done:
    """What is known of a wanted run: it is done, it was tried and why that failed, or neither."""
    store = Store(Path(one.root))
    result = store.result(one.identity)
    if result is not None:
        return Done(one, Status.DONE_BEFORE, f"done before: {one.asked}", _error(result))
    reason = store.reason(one.identity)
    if reason is None:
        return Done(one, Status.TO_DO, f"to do: {one.asked}")
    return Done(one, Status.TO_DO, f"to do again: {one.asked}", reason=reason)


def _error(result: Mapping[str, Any] | None) -> float | None:
    loss = None if result is None else result["loss"]
    return None if loss is None else math.sqrt(loss)


def _each_known(runs: Sequence[Wanted], todo: list[Wanted]) -> Iterator[Done]:
    """The runs that need no worker: done before, or lost before they began; `todo` gets the others.

    Says which of those were stored before and have no result now.
    """
    gone = []
    for one in runs:
        store = Store(Path(one.root))
        if one.lost is not None:
            yield _done(Ended(one, reason=one.lost))
            continue
        result = store.result(one.identity)
        if result is not None:
            told = result_line(one.identity, result, Status.DONE_BEFORE)
            yield Done(one, Status.DONE_BEFORE, told, _error(result))
            continue
        if store.result_is_gone(one.identity):
            gone.append(one.asked)
        todo.append(one)
    if gone:
        print(
            f"{len(gone)} runs were stored before and have no {RESULT} now, because it was deleted "
            f"or their process was killed while it stored them; they run again: {some(gone)}",
            file=sys.stderr,
        )


def _each(runs: Sequence[Wanted], settings: schema.SweepConfig) -> Iterator[Done]:
    """The runs as they end, each in a process of its own."""
    if not runs:
        return
    todo, elsewhere = deque(runs), deque[Wanted]()
    first = _to_compile(runs) if settings.processes > 1 else None
    with (
        Workers(
            _execute, settings.processes, settings.time_limit, MODULES, prepare=_prepare, alone=_own
        ) as workers,
        _stopping(workers) as stop,
    ):
        if first is not None:
            workers.start(first)
        while todo or elsewhere or workers.busy:
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
                    yield _done(Ended(job, reason="did not stop in time", interrupted=True))
                break
            while todo and workers.idle and first is None:
                workers.start(todo.popleft())
            if elsewhere and workers.idle:
                time.sleep(POLL)
                todo.append(elsewhere.popleft())
            for ended in workers.wait(POLL) if workers.busy else ():
                if first is not None:
                    first = None
                    continue
                done = _done(ended)
                if done.status is Status.RUNNING_ELSEWHERE:
                    elsewhere.append(ended.job)
                    continue
                if done.status in (Status.FAILED, Status.LOST) and settings.stop_on_failure:
                    todo.clear()
                    elsewhere.clear()
                yield done
        if stop.number is not None:
            raise Stopped(stop.number)


def _done(ended: Ended[Wanted, Done | None]) -> Done:
    """What a worker says, or what is known of a run whose worker says nothing."""
    one, reason, interrupted = ended.job, ended.reason, ended.interrupted
    if ended.result is not None:
        if interrupted or ended.result.status is not Status.INTERRUPTED:
            return replace(ended.result, wanted=one)
        reason = UNSENT
    reason = redacted(reason or "no answer")
    status = Status.INTERRUPTED if interrupted else Status.LOST
    if ended.result is None:  # else it has kept its curve
        Store(Path(one.root)).keep_reason(one.identity, reason, ended.detail, str(status))
    who = f"{one.identity.problem} {one.identity.optimizer} seed {one.identity.seed}"
    return Done(one, status, f"{who}: {status}: {reason}", reason=reason)


def _own(one: Wanted) -> bool:
    return one.own


def _prepare(one: Wanted) -> None:
    """In a worker: what runs of a user's model share, so that each is forked with it."""
    if not one.own:
        return
    with single_thread():
        kernel().recent()
        environment_stamp()
        optimizer = build_optimizer(_read(one.setting))
        our_code(frozenset({CurveFit.__module__, type(optimizer).__module__}))
        _dataset(one.setting)
        packages_of(optimizer)


def _to_compile(runs: Sequence[Wanted]) -> Wanted | None:
    """A run whose method is to be compiled before the others start: each would compile the same."""
    by_method = {one.identity.optimizer: one for one in reversed(runs) if not one.own}
    for one in by_method.values():
        if build_optimizer(_read(one.setting)).uncompiled:
            if sys.stderr.isatty():
                print(f"compiling {one.identity.optimizer}, once on this machine", file=sys.stderr)
            return replace(one, compile_only=True)
    return None


def _execute(one: Wanted) -> Done | None:
    """In a process of its own: do a run, unless it is done; or only compile what it needs."""
    if one.compile_only:
        experiment = _built(one.setting)
        warm_up(experiment.optimizer, experiment.problem)
        return None
    root = Path(one.root).absolute()  # before a model of the user's may change the folder
    experiment = replace(_built(one.setting), identity=one.identity, root=root)
    execution = run(experiment, quiet=True)
    last = (execution.error or "").strip().splitlines()[-1:]
    return Done(
        one,
        execution.status,
        line(experiment, execution),
        _error(None if execution.run is None else execution.run.result),
        last[0] if last else None,
    )


@lru_cache(maxsize=32)
def _built(setting: str) -> Experiment:
    """What all seeds of a setting share; reading a setting takes longer than a small run."""
    cfg = _read(setting)
    if runs_own_code(cfg):
        return build(cfg, build_problem(cfg, _dataset(setting)))
    return build(cfg, _problem(_of_problem(cfg)))


@lru_cache(maxsize=32)
def _read(setting: str) -> DictConfig:
    return cast(DictConfig, OmegaConf.create(setting))


@lru_cache(maxsize=2)
def _dataset(setting: str) -> Dataset:
    node = OmegaConf.to_container(_read(setting).dataset, resolve=True)
    return build_dataset(cast(dict[str, Any], node))


def _of_problem(cfg: DictConfig) -> str:
    return OmegaConf.to_yaml(OmegaConf.create({key: cfg[key] for key in PROBLEM}), resolve=True)


@lru_cache(maxsize=2)
def _problem(setting: str) -> CurveFit:
    return build_problem(cast(DictConfig, OmegaConf.create(setting)))


@contextmanager
def _stopping(workers: Workers[Any, Any]) -> Iterator[Stop]:
    """While this lasts, the first signal asks the workers to stop, the second ends all at once."""
    stop = Stop()

    def on_signal(number: int, frame: FrameType | None) -> None:
        if stop.number is not None:
            raise Stopped(number)
        stop.number, stop.at = number, time.monotonic()
        workers.interrupt()

    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    heeded = [number for number in SIGNALS if number != HANG_UP or not ignores_hang_up()]
    before = {number: signal.signal(number, on_signal) for number in heeded}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _bar(total: int, processes: int) -> Iterator[Progress]:
    """A bar on a terminal, else a line for each run."""
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

    def tell(self, done: Done) -> None:
        """Count one run and show where the sweep stands."""
        self.counts[done.status] += 1
        problem = done.wanted.identity.problem
        if done.error is not None:
            self.best[problem] = min(done.error, self.best.get(problem, float("inf")))
        bad = self.counts[Status.FAILED] + self.counts[Status.LOST]
        if self.bar.disable:
            print(f"[{self.counts.total()}/{self.total}] {done.line}", flush=True)
            return
        self.bar.update()
        best = "" if len(self.best) != 1 else f", best {next(iter(self.best.values())):.5g}"
        running = min(self.processes, self.total - self.counts.total())
        self.bar.set_postfix_str(f"{running} running, {bad} failed{best}")
        if done.reason is not None:
            self.bar.write(done.line, file=sys.stderr)
