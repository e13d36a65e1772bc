"""R12: one method by two names while other work begins, on one core and on all."""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import threadpoolctl
from numpy.typing import NDArray

from experiments.diagnosis.machine import busy_cores
from miho.optim import Budget, Parameter, Problem, RandomSearch, RunRecord, Space, minimize
from miho.quantities import Array
from miho.study import single_thread
from miho.study.contention import stamped
from tests.faults.conftest import Figures, skip_if_busy

PAIRS, SECONDS = 40, 0.02
CPU_RATIO, WALL_RATIO = (0.95, 1.05), (0.90, 1.10)
SIZE, PRODUCTS, ONE_CORE = 400, 20, 1.1
SLOT_PAIRS = 10
ASLEEP = 0.5
WORK, WORK_REPEATS = 2**16, 20


@pytest.mark.timed
@pytest.mark.fault(
    row="R12",
    fault="one method by two names, load on all cores in the second half; one slot and all",
    promise="CPU ratio 0.95 to 1.05, interleaved wall ratio 0.90 to 1.10, loaded runs flagged, "
    "one thread",
)
def test_timing(tmp_path: Path, measured: Figures) -> None:
    """Ratios of a method with itself, interleaved and in sequence, with load from half time on."""
    busy = busy_cores()
    cores, evaluations = cores_of_products(), evaluations_in()
    (alternating, _), (in_sequence, work) = (
        loaded_halfway(evaluations, interleaved=interleaved) for interleaved in (True, False)
    )
    alone, crowded = slots(evaluations)
    later = alternating.valid[len(alternating.valid) // 2 :]
    flagged = int((~later).sum() + (~in_sequence.valid[:, 1]).sum())
    loaded = later.size + len(in_sequence.valid)
    wrong = alternating.outside()
    for name, ratio in (("CPU in sequence", in_sequence.cpu_ratio), ("slots", crowded / alone)):
        if not CPU_RATIO[0] <= ratio <= CPU_RATIO[1]:
            wrong.append(f"{name} {ratio:.3f} outside {CPU_RATIO[0]} to {CPU_RATIO[1]}")
    measured(
        f"interleaved: CPU {alternating.cpu_ratio:.3f}, wall {alternating.wall_ratio:.3f}; in "
        f"sequence: CPU {in_sequence.cpu_ratio:.3f}, wall {in_sequence.wall_ratio:.3f}; CPU of "
        f"all slots by one {crowded / alone:.3f}; {flagged} of {loaded} loaded runs flagged; "
        f"matrix products kept {cores:.2f} cores busy" + "".join(f"; {ratio}" for ratio in wrong)
    )
    assert cores <= ONE_CORE
    assert flagged == loaded
    skip_if_busy(busy)
    if wrong and not alternating.outside() and work > CPU_RATIO[1]:
        pytest.skip(f"the CPU time of fixed work changed by a factor of {work:.2f}")
    assert not wrong


def test_a_pinned_library_uses_one_core() -> None:
    assert cores_of_products() < 1.1


def loaded_halfway(evaluations: int, *, interleaved: bool) -> tuple[Pairs, float]:
    """The A/A test with two busy processes for each core from its middle on.

    Besides, by how much the CPU time of fixed work changed from one end of its halves to another,
    as a ratio. It is 1 where cores are a process's own, and more where processors share a core or
    their host has other work for it: then CPU time does not say what a method costs, and no
    threshold of it can be judged.
    """
    works = [fixed_work()]
    with contextlib.ExitStack() as stack:

        def halfway() -> None:
            works.append(fixed_work())
            stack.enter_context(load())
            works.append(fixed_work())

        pairs = same_method_twice(evaluations, interleaved=interleaved, halfway=halfway)
        works.append(fixed_work())
    return pairs, max(works) / min(works)


@contextlib.contextmanager
def load(settle: float = 0.2) -> Iterator[None]:
    """Two busy processes for each core, which end with the context; begins when they are busy."""
    busy = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"])
        for _ in range(2 * (os.cpu_count() or 1))
    ]
    try:
        time.sleep(settle)
        yield
    finally:
        for process in busy:
            process.kill()
        for process in busy:
            process.wait()


def fixed_work() -> float:
    """The median CPU seconds of some sines."""
    values = [i / WORK for i in range(WORK)]
    took = []
    for _ in range(WORK_REPEATS):
        started = time.process_time()
        sum(map(math.sin, values))
        took.append(time.process_time() - started)
    return float(np.median(took))


def cores_of_products() -> float:
    """Cores that matrix products keep busy within `single_thread`: what a library really does.

    Threads that a library starts in a new process spin for a while; they are left to fall asleep.
    """
    square = np.ones((SIZE, SIZE))
    with single_thread():
        square @ square
        time.sleep(ASLEEP)
        threads = [pool["num_threads"] for pool in threadpoolctl.threadpool_info()]
        wall, cpu = time.perf_counter(), time.process_time()
        for _ in range(PRODUCTS):
            square @ square
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return max(cpu / wall, *threads) if max(threads, default=1) > 1 else cpu / wall


def slots(evaluations: int) -> tuple[float, float]:
    """CPU seconds of a run when one process computes, and when one for each core does."""
    cores = os.cpu_count() or 1
    with ProcessPoolExecutor(cores, multiprocessing.get_context("spawn")) as pool:
        list(pool.map(slot, [evaluations] * 2 * cores))  # all have started and compiled
        alone = list(pool.map(slot, [evaluations]))
        crowded = list(pool.map(slot, [evaluations] * cores))
    return float(np.median(alone)), float(np.median(crowded))


def slot(evaluations: int) -> float:
    """The median CPU seconds of some runs in this process."""
    return float(np.median(same_method_twice(evaluations, SLOT_PAIRS).cpu))


class Waves(Problem):
    """Mean square of sines at 200 points over (n, 3) amplitudes; a row takes some microseconds."""

    name = "waves"
    space = Space(tuple(Parameter(name, "-", -1.0, 1.0) for name in "abc"))

    def __init__(self) -> None:
        self._basis = np.sin(np.outer([1.0, 2.0, 3.0], np.linspace(0.0, 6.0, 200)))

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Losses (n,)."""
        values = np.sin(thetas[:, :1] * self._basis[0]) + thetas[:, 1:2] * self._basis[1]
        return np.asarray(((values + thetas[:, 2:] * self._basis[2]) ** 2).mean(axis=1))


@dataclass(frozen=True, eq=False)
class Pairs:
    """Seconds (n, 2) of wall and CPU time under two names, and whether each run was valid."""

    wall: Array
    cpu: Array
    valid: NDArray[np.bool_]

    @property
    def cpu_ratio(self) -> float:
        """Ratio of the total CPU times of the first and the second name."""
        return _ratio(self.cpu)

    @property
    def wall_ratio(self) -> float:
        """Ratio of the total wall times of the first and the second name."""
        return _ratio(self.wall)

    def outside(self) -> list[str]:
        """Texts on the ratios outside their intervals."""
        ratios = ("CPU", self.cpu_ratio, CPU_RATIO), ("wall", self.wall_ratio, WALL_RATIO)
        return [
            f"{name} ratio {ratio:.3f} outside {low:g} to {high:g}"
            for name, ratio, (low, high) in ratios
            if not low <= ratio <= high
        ]


def same_method_twice(
    evaluations: int,
    pairs: int = PAIRS,
    *,
    interleaved: bool = True,
    halfway: Callable[[], None] | None = None,
) -> Pairs:
    """Random search under two names, `pairs` times each, in the order ABBA or all A before all B.

    `halfway` is called between the first half of all runs and the second half.
    """
    order = [(pair, name) for pair in range(pairs) for name in ((0, 1), (1, 0))[pair % 2]]
    if not interleaved:
        order.sort(key=lambda run: run[1])
    wall, cpu = np.empty((pairs, 2)), np.empty((pairs, 2))
    valid = np.zeros((pairs, 2), bool)
    for number, (pair, name) in enumerate(order):
        if number == pairs and halfway is not None:
            halfway()
        with single_thread(), stamped() as stamp:
            record = _search(pair, Budget(evaluations=evaluations))
        wall[pair, name], cpu[pair, name] = record.seconds, record.cpu_seconds
        valid[pair, name] = stamp.judge(record.seconds, record.cpu_seconds).valid
    return Pairs(wall, cpu, valid)


def evaluations_in(seconds: float = SECONDS) -> int:
    """Number of evaluations that take this CPU time here."""
    with single_thread():
        record = _search(0, Budget(evaluations=5000))
        record = _search(0, Budget(evaluations=5000))
    return max(1, int(5000 * seconds / record.cpu_seconds))


def _search(seed: int, budget: Budget) -> RunRecord:
    return minimize(RandomSearch(batch=100), Waves(), budget, seed)


def _ratio(seconds: Array) -> float:
    first, second = seconds.sum(axis=0)
    return float(first / second)


@pytest.mark.parametrize("interleaved", [True, False])
def test_both_names_run_as_often_and_the_middle_is_the_middle(interleaved: bool) -> None:
    calls: list[int] = []
    pairs = same_method_twice(
        100, pairs=3, interleaved=interleaved, halfway=lambda: calls.append(1)
    )
    assert calls == [1]
    assert pairs.wall.shape == pairs.cpu.shape == pairs.valid.shape == (3, 2)
    assert (pairs.cpu > 0).all()


@pytest.mark.parametrize(("ratio", "wrong"), [(1.01, 0), (1.07, 1), (0.93, 1), (2.0, 2)])
def test_a_difference_from_itself_is_seen(ratio: float, wrong: int) -> None:
    seconds = np.tile([ratio, 1.0], (4, 1))
    assert len(Pairs(seconds, seconds, np.full((4, 2), True)).outside()) == wrong
