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
from functools import lru_cache
from pathlib import Path
from types import FrameType, MappingProxyType
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf
from tqdm import tqdm

from experiments import schema
from experiments.build import Experiment, build, build_problem
from experiments.manifest import refuse_other_settings, write_manifest
from experiments.mirror import Mirror, open_mirror
from experiments.run import line, run
from experiments.stopped import Stopped
from miho.identification import CurveFit
from miho.study import Identity, Status, Store, StoredRun
from miho.study.changes import refuse_changes
from miho.study.redaction import redacted
from miho.study.workers import Ended, Workers

PROBLEM = ("model", "dataset", "space", "loss", "problem")
AGAIN, GRACE = 1.5, 3.5
"""Seconds after the first signal until it is repeated, because Python loses one that strikes in a
callback of a library, and until what still runs is killed, so that all is over in five."""
POLL = 0.2
SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGUSR1")
                if hasattr(signal, name))  # fmt: skip


@dataclass(frozen=True)
class Wanted:
    """One run: what was asked in the user's words, its configuration in YAML, and who it is."""

    asked: str
    setting: str
    identity: Identity
    root: str


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


def wanted(cfg: DictConfig, asked: str, seeds: Sequence[int]) -> list[Wanted]:
    """The runs of one configuration with several seeds; raises ConfigError for a bad one."""
    setting = OmegaConf.to_yaml(cfg)
    experiment = build(cfg, _problem(_of_problem(cfg)))
    return [
        Wanted(f"{asked} seed={seed}".strip(), setting, replace(experiment.identity, seed=seed),
               str(cfg.root))
        for seed in seeds
    ]  # fmt: skip


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
            for done in _each(unique, settings):
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
    stored = store.find(one.identity)
    if stored is not None:
        return Done(one, Status.DONE_BEFORE, f"done before: {one.asked}", _error(stored))
    reason = store.reason(one.identity)
    if reason is None:
        return Done(one, Status.TO_DO, f"to do: {one.asked}")
    return Done(one, Status.TO_DO, f"to do again: {one.asked}", reason=reason)


def _error(stored: StoredRun | None) -> float | None:
    loss = None if stored is None else stored.result["loss"]
    return None if loss is None else math.sqrt(loss)


def _each(runs: Sequence[Wanted], settings: schema.SweepConfig) -> Iterator[Done]:
    """The runs as they end."""
    todo, elsewhere = deque(runs), deque[Wanted]()
    modules = ("experiments.sweep",)
    with (
        Workers(_execute, settings.processes, settings.time_limit, modules) as workers,
        _stopping(workers) as stop,
    ):
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
                for job in left:
                    yield _done(Ended(job, reason="did not stop in time", interrupted=True))
                break
            while todo and workers.idle:
                workers.start(todo.popleft())
            if elsewhere and workers.idle:
                time.sleep(POLL)
                todo.append(elsewhere.popleft())
            for ended in workers.wait(POLL) if workers.busy else ():
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


def _done(ended: Ended[Wanted, Done]) -> Done:
    """What a worker says, or what is known of a run whose worker says nothing."""
    if ended.result is not None:
        return replace(ended.result, wanted=ended.job)
    one, reason = ended.job, redacted(ended.reason or "no answer")
    status = Status.INTERRUPTED if ended.interrupted else Status.LOST
    Store(Path(one.root)).keep_reason(one.identity, reason, ended.detail, str(status))
    who = f"{one.identity.problem} {one.identity.optimizer} seed {one.identity.seed}"
    return Done(one, status, f"{who}: {status}: {reason}", reason=reason)


def _execute(one: Wanted) -> Done:
    """Do a run in this process, unless it is done."""
    experiment = replace(_built(one.setting), identity=one.identity)
    execution = run(experiment, quiet=True)
    last = (execution.error or "").strip().splitlines()[-1:]
    return Done(
        one,
        execution.status,
        line(experiment, execution),
        _error(execution.run),
        last[0] if last else None,
    )


@lru_cache(maxsize=32)
def _built(setting: str) -> Experiment:
    """What all seeds of a setting share; reading a setting takes longer than a small run."""
    cfg = cast(DictConfig, OmegaConf.create(setting))
    return build(cfg, _problem(_of_problem(cfg)))


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
    before = {number: signal.signal(number, on_signal) for number in SIGNALS}
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
