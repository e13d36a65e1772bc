"""Run what is not done yet, once, and keep what was found."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from miho.optim import Outcome, RunRecord, Space
from miho.study.environment import environment_stamp, single_thread
from miho.study.identity import Identity
from miho.study.redaction import without_secrets
from miho.study.store import RunInUse, Store, StoredRun
from miho.study.validity import stamped


class Status(StrEnum):
    """What became of a requested run; `lost` are those whose process ended, or never did."""

    RAN = "ran"
    DONE_BEFORE = "done before"
    RUNNING_ELSEWHERE = "running elsewhere"
    FAILED = "failed"
    INTERRUPTED = "interrupted"
    LOST = "lost"
    TO_DO = "to do"


@dataclass(frozen=True)
class Execution:
    """A requested run: its status, the stored run if there is one, else where the rest lies."""

    status: Status
    run: StoredRun | None = None
    partial: Path | None = None
    error: str | None = None


def execute(
    store: Store,
    identity: Identity,
    job: Callable[[], RunRecord],
    space: Space,
    facts: Mapping[str, Any],
) -> Execution:
    """Run `job` on one thread unless the store has its result, and commit what it returns.

    A failed or interrupted run is kept as partial and will run again.
    """
    done = store.find(identity)
    if done is not None:
        return Execution(Status.DONE_BEFORE, done)
    try:
        with store.claim(identity):
            done = store.find(identity)
            if done is not None:
                return Execution(Status.DONE_BEFORE, done)
            with single_thread(), stamped() as stamp:
                environment = environment_stamp()
                record = without_secrets(job())
            if record.outcome in (Outcome.FAILED, Outcome.INTERRUPTED):
                partial = store.keep_partial(identity, record)
                failed = record.outcome is Outcome.FAILED
                status = Status.FAILED if failed else Status.INTERRUPTED
                return Execution(status, partial=partial, error=record.error)
            timing = stamp.judge(record.seconds, record.cpu_seconds)
            environment["timing"] = timing.as_dict()
            facts = {**facts, "timing_valid": timing.valid}
            return Execution(Status.RAN, store.commit(identity, record, space, environment, facts))
    except RunInUse:
        return Execution(Status.RUNNING_ELSEWHERE)
