"""R12: one method by two names while other work begins, on one core and on all."""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import threadpoolctl

from experiments.diagnosis.machine import (
    CPU_RATIO,
    Pairs,
    busy_cores,
    evaluations_in,
    same_method_twice,
)
from miho.study import single_thread
from tests.faults.conftest import Figures, skip_if_busy

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
