"""Run one method on one problem within one budget, and record the result."""

from __future__ import annotations

import contextlib
import copy
import math
import signal
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
from typing import TYPE_CHECKING, Any

from miho.optim.meter import Budget, BudgetExhausted, Meter, RunInterrupted
from miho.optim.optimizer import Optimizer, Resumable
from miho.optim.oracle import Oracle
from miho.optim.problem import Problem
from miho.optim.seeds import stream
from miho.optim.space import Space
from miho.optim.trace import Descents, Trace
from miho.parallel.errors import SPURIOUS_INTERRUPT, NoWorkersLeft, StaleJournalError
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.optim.spread import JournalFile
    from miho.parallel import Evaluations, Workers
    from miho.parallel.usage import Usage


class Outcome(StrEnum):
    """How a run ended.

    `BUDGET`: at its budget or target. `CONVERGED`: by itself, with enough evidence for its best
    optimum if it is a method of brackets. `BRACKETS`: after its largest number of brackets, without
    this evidence. `NO_FINITE_VALUE`: no loss was finite. `FAILED`: the method raised, or no worker
    was left. `INTERRUPTED`: Ctrl-C.
    """

    BUDGET = "budget"
    CONVERGED = "converged"
    BRACKETS = "brackets"
    NO_FINITE_VALUE = "no_finite_value"
    FAILED = "failed"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class Checkpoint:
    """A run between two evaluations; pickle it, and resume it bit-exactly with `minimize`.

    Attributes
    ----------
    optimizer : Optimizer
        The method.
    problem : str
        Name of the problem.
    seed : int
        Seed of the run.
    state : object
        State of the method.
    meter : Meter
        Counts and results of the run so far.
    """

    optimizer: Optimizer
    problem: str
    seed: int
    state: Any
    meter: Meter


@dataclass(frozen=True)
class RunRecord:
    """Result of one run.

    Attributes
    ----------
    outcome : Outcome
        How the run ended.
    theta : ndarray of shape (d,) or None
        Best configuration, in units; None if no loss was finite.
    loss : float
        Its loss; math.inf if no loss was finite.
    evaluations, seconds, cpu_seconds, setup_seconds : float
        Evaluations used, wall and CPU time of the method, and time for imports and traced formulas.
    trace : Trace
        The improvements of the run.
    rejected : mapping of str to int
        Unusable values by reason.
    error : str, optional
        Traceback of a failed run, with the line of the method's file at the end, or one line if no
        worker was left.
    checkpoint : Checkpoint, optional
        Resumes a `Resumable` method; None after an interrupt in the middle of a step.
    outside : int
        Evaluations outside the bounds; of compiled blocks, improvements only.
    descents : Descents, optional
        Summary of the descents of a method that makes several.
    usage : Usage, optional
        Use of the workers; None without workers and journal.
    provisional : ndarray of shape (d,), optional
        Best configuration on fewer than all rows of the data, if none was evaluated on all of them.
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
) -> RunRecord:
    """Minimise the loss of a problem with one method.

    Errors of the model or of the method end up in the record. The first Ctrl-C ends the run after
    the current evaluation, as `Outcome.INTERRUPTED`; the second ends it at once.

    Parameters
    ----------
    optimizer : Optimizer
        The method.
    problem : Problem
        The problem, without fixed and tied parameters (a `CurveFit` removes them).
    budget : Budget, optional
        Limits of the run; none by default.
    seed : int, optional
        The repetition. Problem and seed determine the common initial configurations; the random
        stream of the method also depends on its name.
    checkpoint : Checkpoint, optional
        Continue this run of the same optimizer, problem and seed, under the new budget.
    observer : callable, optional
        Called with the oracle about ten times a second, off the clock of the method, to show
        progress.
    workers : int, str, executor or callable, optional
        Workers for expensive problems: a number of processes (-1 for one per core), an executor of
        `concurrent.futures`, a callable like `map`, or the address of a cluster
        (`miho.parallel.pool`). The result does not depend on them, except for `AsynchronousMIHOGN`.
    evaluation_limit : float, optional
        Time limit of an evaluation, in seconds. A longer one has no value, nor has an evaluation
        whose worker dies three times.
    journal : path, optional
        File that stores every evaluation longer than about 10 ms. The same run, called again after
        an interruption, reuses them and repeats only a few, to check the model.

    Returns
    -------
    RunRecord
        Best configuration, evaluations used, and how the run ended. If all workers are lost, the
        run has failed and keeps its best configuration.

    Raises
    ------
    ValueError
        If an argument is no method, problem, budget or seed, or if problem, method and checkpoint
        do not fit together.
    JournalError
        If the journal belongs to another problem, or if its values have changed.

    Examples
    --------
    >>> import miho
    >>> class Bowl(miho.Problem):
    ...     name = "bowl"
    ...     space = miho.Space((miho.Parameter("a", "m", -5, 5), miho.Parameter("b", "m", -5, 5)))
    ...     def loss(self, thetas, fidelity=1.0):
    ...         return ((thetas - [1, 2]) ** 2).sum(axis=1)
    >>> record = miho.minimize(miho.MIHOQN(), Bowl(), miho.Budget(evaluations=2000))
    >>> str(record.outcome), record.theta.round(4)
    ('converged', array([1., 2.]))
    """
    space, name = (problem.space, problem.name) if isinstance(problem, Problem) else (None, None)
    arguments = optimizer, problem, space, name, budget, seed
    if not all(map(isinstance, arguments, (Optimizer, Problem, Space, str, Budget | None, int))):
        from miho.optim.refused_arguments import checked_seed

        seed = checked_seed(*arguments)
    if problem.space.free is not problem.space:
        raise ValueError(
            f"{problem.name}: expected free parameters only; use a CurveFit for fixed and tied ones"
        )
    if checkpoint is not None:
        checkpoint = _resumable(checkpoint, optimizer, problem, seed)
    space = problem.space.seeded(problem.name, seed)
    meter = None if checkpoint is None else checkpoint.meter
    with _spread(problem, workers, evaluation_limit, journal) as (spread, evaluations):
        setup_started = time.perf_counter()
        _load(optimizer, problem)
        setup_seconds = time.perf_counter() - setup_started
        oracle = Oracle(
            spread, budget or Budget(), space=space, meter=meter, observer=observer,
            evaluations=evaluations,
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
        provisional=None if len(meter.trace) or early is None else early.theta,
    )


def _spread(
    problem: Problem, workers: Workers | Evaluations, limit: float | None, journal: JournalFile
) -> contextlib.AbstractContextManager[tuple[Any, Evaluations | None]]:
    """The problem with its evaluations on workers or in a journal, if there are any."""
    if workers is None and limit is None and journal is None:
        return contextlib.nullcontext((problem, None))
    from miho.optim.spread import spread_problem

    return spread_problem(problem, workers, limit, journal)


def _search(
    optimizer: Optimizer, oracle: Oracle, checkpoint: Checkpoint | None, run: tuple[str, int]
) -> tuple[Outcome, str | None]:
    """Run or resume the method; returns the outcome, and the traceback if it failed.

    `run` is the problem's name and the seed. `oracle.state` is None if it cannot be resumed.
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
    except StaleJournalError:  # there is no usable result
        raise
    except NoWorkersLeft as reason:  # at an evaluation, so the state is whole
        outcome, error = Outcome.FAILED, f"{reason}\n"
    except BaseException as raised:  # noqa: BLE001 -- a failed run is a result: its curve is kept
        outcome, oracle.state = Outcome.FAILED, None
        last = "".join(traceback.format_exception_only(raised))  # one line, for a message
        above = traceback.format_exc().removesuffix(last)
        error = f"{above}{' '.join(last.split())} ({raised_at(raised, optimizer)})\n"
    return outcome, error


def _final(outcome: Outcome, oracle: Oracle) -> Outcome:
    """Outcome corrected for exhausted brackets, a reached target, or no finite value."""
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
    """File and line where a method raised: the last line in its file, else the last of all.

    The last line of all may be deep in a library that the method calls.
    """
    lines = traceback.extract_tb(error.__traceback__)
    codes = [getattr(member, "__code__", None) for member in vars(type(optimizer)).values()]
    files = {code.co_filename for code in codes if code is not None}
    line = ([line for line in lines if line.filename in files] or lines)[-1]
    return f"{Path(line.filename).name}:{line.lineno}"


def _resumable(
    checkpoint: Checkpoint, optimizer: Optimizer, problem: Problem, seed: int
) -> Checkpoint:
    """Copy of a checkpoint for the resumed run; raises ValueError if it belongs to another run."""
    if not isinstance(optimizer, Resumable):
        raise ValueError(
            f"{type(optimizer).__name__} cannot be resumed; expected a Resumable method"
        )
    run = (optimizer, problem.name, seed)
    origin = (checkpoint.optimizer, checkpoint.problem, checkpoint.seed)
    if run != origin:
        raise ValueError(f"checkpoint: expected a run of {run}, got {origin}; resume the same run")
    return copy.deepcopy(checkpoint)


@contextlib.contextmanager
def _ctrl_c_waits(on_first: Callable[[], object]) -> Iterator[None]:
    """Call `on_first` at the first Ctrl-C without raising; raise KeyboardInterrupt at the second.

    A run then ends at an evaluation, where the state of the method is complete; an exception raised
    in a callback of a library could get lost. This applies to the main thread only, and only if no
    one else handles the signal. A KeyboardInterrupt without Ctrl-C comes from the model or the
    method and becomes a RuntimeError.
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
    """Import, trace and check everything that is used for the first time, without evaluating.

    This covers the method, the common start and the fast form of the problem, before the clock
    starts.
    """
    for name in optimizer.loads:
        import_module(name)
    problem.space.initial(1)
    with contextlib.suppress(Exception):  # the run will raise and report it
        if problem.kernel is not None:
            _ = problem.kernel.rows
