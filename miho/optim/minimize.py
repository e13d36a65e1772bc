"""Run one method on one problem within one budget, and say how it ended."""

from __future__ import annotations

import contextlib
import copy
import math
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import Any

from miho.optim.meter import Arrivals, Budget, BudgetExhausted, Meter, RunInterrupted
from miho.optim.optimizer import Optimizer, Resumable
from miho.optim.oracle import Oracle
from miho.optim.problem import Problem
from miho.optim.seeds import stream
from miho.optim.spread import JournalFile, spread_problem
from miho.optim.trace import Descents, Trace
from miho.parallel import Evaluations, NoWorkersLeft, StaleJournalError, Workers
from miho.parallel.usage import Usage
from miho.parallel.worker_process import SPURIOUS_INTERRUPT
from miho.quantities import Array


class Outcome(StrEnum):
    """How a run ended: by its budget or target, by itself, or otherwise.

    By itself it has `converged`, or made the largest number of `brackets` without evidence enough
    that its best optimum is the best of all.
    """

    BUDGET = "budget"
    CONVERGED = "converged"
    BRACKETS = "brackets"
    NO_FINITE_VALUE = "no_finite_value"
    FAILED = "failed"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class Checkpoint:
    """A run at one moment between two evaluations: pickle it, and resume bit-exactly."""

    optimizer: Optimizer
    problem: str
    seed: int
    state: Any
    meter: Meter


@dataclass(frozen=True)
class RunRecord:
    """What one run found, and what it spent.

    `theta` (d,) in units and `loss` are the best seen, None and math.inf if nothing was finite.
    `seconds` is the method's clock; imports and traced formulas are in `setup_seconds`.
    `rejected` counts unusable values by reason; `error` holds the traceback of a failed run, with
    the line of the method's file at its end, or one line where all workers are gone.
    `outside` counts evaluations outside of the box, in compiled blocks only those that improve.
    `descents` says where those of a method that makes several ended, None of any other.
    `checkpoint` resumes a method that can be resumed (Resumable), else it is None; so it is after
    an interrupt that struck in the middle of a step. `usage` says how workers were used, None
    without workers and journal; `arrivals` in which order a method took their evaluations that
    works asynchronously, None with one worker. `provisional` (d,) is the best configuration on
    fewer rows of data than all, None where one was looked at on all of them.
    """

    outcome: Outcome
    theta: Array | None
    loss: float
    evaluations: float
    seconds: float
    cpu_seconds: float
    setup_seconds: float
    trace: Trace
    rejected: Mapping[str, int]
    error: str | None = None
    checkpoint: Checkpoint | None = None
    outside: int = 0
    descents: Descents | None = None
    usage: Usage | None = None
    arrivals: Arrivals | None = None
    provisional: Array | None = None


def minimize(
    optimizer: Optimizer,
    problem: Problem,
    budget: Budget | None = None,
    seed: int = 0,
    *,
    checkpoint: Checkpoint | None = None,
    observer: Callable[[Oracle], None] | None = None,
    workers: Workers | Evaluations = None,
    evaluation_limit: float | None = None,
    journal: JournalFile = None,
    replay: Arrivals | None = None,
) -> RunRecord:
    """Minimise the problem's loss; always returns a record, whatever model or method did.

    `seed` is the repetition: (problem, seed) fixes the common initial configurations, the
    method's name is mixed in only for its own stream. A `checkpoint` of the same optimizer,
    problem and seed is continued under the new, larger budget. `observer` is called with the
    oracle about ten times a second, off the method's clock, to show progress. What is imported or
    traced at its first use is so before the clock starts. The first Ctrl-C ends the run as
    `interrupted` after the evaluation in progress, the second at once.

    `workers` make the evaluations of a problem where each takes long: a number of processes, -1
    for one per core, an executor of `concurrent.futures`, a callable like `map`, or the address of
    a cluster (`miho.parallel.pool`). The result does not depend on them, but that of asynchronous
    methods. A value that takes longer than `evaluation_limit` seconds is given up, and so is one
    whose worker dies three times; a run whose workers are all gone has failed, and keeps what it
    found. A `journal` is a file in which every evaluation stands that takes longer than some 10 ms:
    the same run, called again after it was cut off, makes only a few of them again, to compare the
    model; JournalError is raised for another problem and for one whose values have changed. Where
    the decisions of a method depend on which evaluation was there first, `replay`, the `arrivals`
    of another run of it, has it make the same
    ones, with any workers.
    """
    if problem.space.free is not problem.space:
        raise ValueError(
            f"{problem.name}: fixed and tied parameters need a CurveFit; leave them out"
        )
    if checkpoint is not None:
        checkpoint = _resumable(checkpoint, optimizer, problem, seed)
    space = problem.space.seeded(problem.name, seed)
    meter = None if checkpoint is None else checkpoint.meter
    with spread_problem(problem, workers, evaluation_limit, journal) as (spread, evaluations):
        setup_started = time.perf_counter()
        _load(optimizer, problem)
        setup_seconds = time.perf_counter() - setup_started
        oracle = Oracle(
            spread, budget or Budget(), space=space, meter=meter, observer=observer,
            evaluations=evaluations, replay=replay,
        )  # fmt: skip
        outcome, error = _search(optimizer, oracle, checkpoint, (problem.name, seed))
        oracle.stop()

    meter, early = oracle.meter, oracle.meter.provisional
    resumable = None
    if oracle.state is not None:
        resumable = Checkpoint(optimizer, problem.name, seed, oracle.state, meter)
    return RunRecord(
        outcome=_final(outcome, oracle),
        theta=meter.trace.theta[-1].copy() if len(meter.trace) else None,
        loss=meter.best,
        evaluations=meter.evaluations,
        seconds=meter.seconds,
        cpu_seconds=meter.cpu_seconds,
        setup_seconds=setup_seconds,
        trace=meter.trace,
        rejected=dict(meter.rejected),
        error=error,
        checkpoint=resumable,
        outside=meter.outside,
        descents=Descents.of(meter.starts, meter.best, outcome is Outcome.CONVERGED),
        usage=None if evaluations is None else evaluations.usage,
        arrivals=meter.arrivals if meter.arrivals.positions else None,
        provisional=None if len(meter.trace) or early is None else early.theta,
    )


def _search(
    optimizer: Optimizer, oracle: Oracle, checkpoint: Checkpoint | None, run: tuple[str, int]
) -> tuple[Outcome, str | None]:
    """Run or resume the method; what ended it, and the traceback if it failed.

    `run` is the problem's name and the seed. `oracle.state` is None where it cannot be resumed.
    """
    error = None
    try:
        with _ctrl_c_waits(partial(setattr, oracle, "interrupted", True)):
            if checkpoint is not None and isinstance(optimizer, Resumable):
                optimizer.resume(oracle, checkpoint.state)
            else:
                optimizer.run(oracle, stream("own", *run, type(optimizer).__name__))
        outcome = Outcome.CONVERGED
    except BudgetExhausted:
        outcome = Outcome.BUDGET
    except RunInterrupted:
        outcome = Outcome.INTERRUPTED
    except KeyboardInterrupt:
        outcome, oracle.state = Outcome.INTERRUPTED, None
    except StaleJournalError:  # nothing was found that anybody could use
        raise
    except NoWorkersLeft as reason:  # at an evaluation, so the state is whole
        outcome, error = Outcome.FAILED, f"{reason}\n"
    except BaseException as raised:  # noqa: BLE001 -- a failed run is a result: its curve is kept
        outcome, oracle.state = Outcome.FAILED, None
        error = f"{traceback.format_exc().rstrip()} ({raised_at(raised, optimizer)})\n"
    return outcome, error


def _final(outcome: Outcome, oracle: Oracle) -> Outcome:
    """The outcome in the light of what was found: brackets used up, target reached, or nothing."""
    best, target = oracle.best, oracle.budget.target
    if outcome is Outcome.CONVERGED and oracle.meter.starts.exhausted:
        outcome = Outcome.BRACKETS
    by_itself = outcome in (Outcome.CONVERGED, Outcome.BRACKETS)
    if by_itself and target is not None and best <= target:
        outcome = Outcome.BUDGET
    if (by_itself or outcome is Outcome.BUDGET) and math.isinf(best):
        outcome = Outcome.NO_FINITE_VALUE
    return outcome


def raised_at(error: BaseException, optimizer: Optimizer) -> str:
    """File and line of what a method raised: the last line of its own file, else the last of all.

    The last line of all may be deep in a library that the method calls.
    """
    lines = traceback.extract_tb(error.__traceback__)
    file = getattr(sys.modules.get(type(optimizer).__module__), "__file__", None)
    line = ([line for line in lines if line.filename == file] or lines)[-1]
    return f"{Path(line.filename).name}:{line.lineno}"


def _resumable(
    checkpoint: Checkpoint, optimizer: Optimizer, problem: Problem, seed: int
) -> Checkpoint:
    """A copy that the resumed run may change, if it is a checkpoint of this very run."""
    if not isinstance(optimizer, Resumable):
        raise ValueError(
            f"{type(optimizer).__name__} cannot be resumed; only Resumable methods can"
        )
    run = (optimizer, problem.name, seed)
    origin = (checkpoint.optimizer, checkpoint.problem, checkpoint.seed)
    if run != origin:
        raise ValueError(f"the checkpoint is of {origin}, not of {run}; resume the same run")
    return copy.deepcopy(checkpoint)


@contextlib.contextmanager
def _ctrl_c_waits(on_first: Callable[[], object]) -> Iterator[None]:
    """The first Ctrl-C calls `on_first` and raises nothing; the second raises KeyboardInterrupt.

    So a run ends at an evaluation, where the method's state is whole, and not anywhere: in a
    callback of a library what is raised could be lost.

    Only in the main thread and where nobody else handles the signal. There a KeyboardInterrupt
    without a Ctrl-C comes from the model or the method, and becomes a RuntimeError.
    """
    default = signal.default_int_handler
    if (
        threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGINT) is not default
    ):
        yield
        return

    interrupted = False

    def on_interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal interrupted
        if interrupted:
            raise KeyboardInterrupt
        interrupted = True
        on_first()

    signal.signal(signal.SIGINT, on_interrupt)
    try:
        yield
    except KeyboardInterrupt as error:
        if interrupted:
            raise
        raise RuntimeError(SPURIOUS_INTERRUPT).with_traceback(error.__traceback__) from None
    finally:
        signal.signal(signal.SIGINT, default)


def _load(optimizer: Optimizer, problem: Problem) -> None:
    """Import, trace and check what is used for the first time; nothing of the problem is evaluated.

    What a method, the common start and a fast form of the problem need is so there before the clock
    starts.
    """
    for name in optimizer.loads:
        import_module(name)
    problem.space.initial(1)
    with contextlib.suppress(Exception):  # the run itself will meet and report it
        if problem.kernel is not None:
            _ = problem.kernel.rows
