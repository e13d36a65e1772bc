"""R9: the wall clock leaps while runs are timed and locks are held."""

from __future__ import annotations

import ast
import contextlib
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from miho.optim import (
    Budget,
    BudgetExhausted,
    Clock,
    Oracle,
    Parameter,
    Problem,
    RandomSearch,
    Space,
    minimize,
    oracle,
)
from miho.optim.seeds import stream
from miho.quantities import Array
from miho.study import Identity, RunInUse, Store, environment_stamp
from tests.faults.commands import CHECKOUT
from tests.faults.conftest import Figures

HOUR = 3600.0
SIMULATED, REAL = 5.0, 0.2
TOLERANCE, CHUNK = 1e-3, 0.03
SOURCES = ("miho", "baselines", "experiments")
SUMMER_TIME_ENDS = "X0Y,0/0,365/23"
"""A time zone in POSIX form, always in summer time; `UTC` after it sets local time back an hour."""


@dataclass
class Leaping:
    """A wall clock that somebody sets: an hour on or back, or a night's sleep, at every reading."""

    rng: np.random.Generator
    offset: float = 0.0
    readings: int = 0

    def __call__(self) -> float:
        """Seconds since 1970, as `time.time` gives them."""
        self.readings += 1
        self.offset += float(self.rng.choice([-HOUR, HOUR, 8 * HOUR]))
        os.environ["TZ"] = SUMMER_TIME_ENDS if self.readings % 2 else "UTC"
        time.tzset()
        return time.clock_gettime(time.CLOCK_REALTIME) + self.offset


@dataclass
class Simulated(Problem):
    """Rows take simulated seconds that are known; `ends` (n,) is when each was done.

    `now` is the time since boot without sleep. It passes only while losses are computed, so that
    the method's clock must show just what the losses took, whatever recording reads.
    """

    rng: np.random.Generator
    leaping: Leaping
    now: float = 100.0
    ends: list[float] = field(default_factory=list)
    name: str = "simulated"
    space: Space = field(default_factory=lambda: Space((Parameter("x", "-", -1.0, 1.0),)))

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """|x| (n,), after 0.05 to 0.4 ms for each row; reads the wall clock, as models may."""
        self.leaping()
        each = float(self.rng.uniform(0.05e-3, 0.4e-3))
        spent = self.ends[-1] if self.ends else 0.0
        self.ends += [spent + each * (i + 1) for i in range(len(thetas))]
        self.now += each * len(thetas)
        return np.abs(thetas[:, 0])


@pytest.mark.fault(
    row="R9",
    fault="the wall clock leaps by hours, summer time ends, the machine sleeps",
    promise="time axis strictly rising, durations within 1 ms, locks and time limits as ever",
    quick=True,
)
def test_clock(tmp_path: Path, measured: Figures) -> None:
    """Time runs and hold a lock under a wall clock that leaps at every reading."""
    rng = np.random.default_rng(9)
    with leaping_wall_clock(rng) as leaping:
        falls, error, over = simulated_run(rng, leaping)
        inside = real_run(leaping)
        locked = lock_holds(Store(tmp_path), leaping)
        utc = str(environment_stamp()["time"]).endswith("+00:00")
    files = [path for name in SOURCES for path in sorted((CHECKOUT / name).rglob("*.py"))]
    uses = [use for path in files for use in wall_clock_uses(path)]
    measured(
        f"{leaping.readings:,} leaps: {falls} rows not later than the one before, largest error "
        f"{error * 1e3:.3f} ms, budget over by {over * 1e3:.1f} ms (a chunk is 20), a real run "
        f"{'inside' if inside else 'OUTSIDE'} its bounds, the lock {'held' if locked else 'BROKE'};"
        f" {len(uses)} uses of the wall clock for durations in {len(files)} files"
        + "".join(f"; {use}" for use in uses[:3])
    )
    assert not falls
    assert error <= TOLERANCE
    assert over <= CHUNK
    assert inside
    assert locked
    assert utc
    assert not uses
    assert leaping.readings > 0


def test_the_clock_leaps_and_is_put_back() -> None:
    before = time.tzname
    with leaping_wall_clock(np.random.default_rng(0)):
        readings = np.array([time.time() for _ in range(20)])
        assert (np.abs(np.diff(readings)) > 3000).all()
    assert time.tzname == before
    assert abs(time.time() - time.clock_gettime(time.CLOCK_REALTIME)) < 60


def test_a_run_timed_by_the_wall_clock_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    with leaping_wall_clock(rng) as leaping:
        monkeypatch.setattr(
            "tests.faults.test_clock.Clock", lambda wall, cpu: oracle.Clock(time.time, cpu)
        )
        _, error, _ = simulated_run(rng, leaping)
    assert error > 1000
    assert oracle.Clock().wall is time.perf_counter


@pytest.mark.parametrize(
    ("line", "uses"),
    [
        ("time.time()", 1),
        ("clock = time.time_ns", 1),
        ("from time import time", 1),
        ("datetime.datetime.now()", 1),
        ("date.today()", 1),
        ("elapsed = datetime.now(UTC) - started", 1),
        ("datetime.datetime.now(datetime.UTC).isoformat()", 0),
        ("time.perf_counter() - started", 0),
        ("meter.time - now", 0),
    ],
)
def test_what_counts_as_a_use(tmp_path: Path, line: str, uses: int) -> None:
    path = tmp_path / "source.py"
    path.write_text(line)
    assert len(wall_clock_uses(path)) == uses


@contextlib.contextmanager
def leaping_wall_clock(rng: np.random.Generator) -> Iterator[Leaping]:
    """Within it `time.time` and the time zone of this process leap; both are put back."""
    zone, leaping = os.environ.get("TZ"), Leaping(rng)
    try:
        with (
            mock.patch("time.time", leaping),
            mock.patch("time.time_ns", lambda: int(leaping() * 1e9)),
        ):
            yield leaping
    finally:
        if zone is None:
            os.environ.pop("TZ", None)
        else:
            os.environ["TZ"] = zone
        time.tzset()


def simulated_run(rng: np.random.Generator, leaping: Leaping) -> tuple[int, float, float]:
    """Rows of the trace that do not rise, the largest error [s] and the seconds over the budget."""
    problem = Simulated(rng, leaping)
    clock = Clock(wall=lambda: problem.now, cpu=lambda: problem.now)
    oracle = Oracle(problem, Budget(seconds=SIMULATED), clock=clock)
    with contextlib.suppress(BudgetExhausted):
        RandomSearch(batch=50).run(oracle, stream("clock"))
    oracle.stop()
    trace, meter = oracle.trace, oracle.meter
    truth = np.array([problem.ends[int(count) - 1] for count in trace.evaluations])
    error = np.abs(np.append(trace.seconds, meter.seconds) - np.append(truth, problem.ends[-1]))
    falls = int((np.diff(trace.seconds) <= 0).sum())
    return falls, float(error.max()), meter.seconds - SIMULATED


def real_run(leaping: Leaping) -> bool:
    """Whether a run on the real clock takes what its budget says, seen on the kernel's raw one."""
    problem = Simulated(np.random.default_rng(0), leaping)
    started = time.clock_gettime(time.CLOCK_MONOTONIC_RAW)
    record = minimize(RandomSearch(), problem, Budget(seconds=REAL))
    took = time.clock_gettime(time.CLOCK_MONOTONIC_RAW) - started
    rising = bool((np.diff(record.trace.seconds) > 0).all())
    return rising and REAL <= record.seconds <= took + TOLERANCE


def lock_holds(store: Store, leaping: Leaping) -> bool:
    """Whether a second claim is refused at once while the first is held, and not afterwards."""
    identity = Identity("clock", "random", 0, {}, code="c0de", data="da7a")
    started = time.perf_counter()
    with store.claim(identity):
        leaping()
        try:
            with store.claim(identity):
                return False
        except RunInUse:
            refused = time.perf_counter() - started
    leaping()
    with store.claim(identity):
        return refused < HOUR / 60


def wall_clock_uses(path: Path) -> list[str]:
    """Where a source file could take a duration from the wall clock.

    That is any use of `time.time` or `time.time_ns`, a date without its time zone, and a
    subtraction of the date of now. A date that is only written down is no duration.
    """
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        imported = isinstance(node, ast.ImportFrom) and node.module == "time"
        names = {alias.name for alias in node.names} if isinstance(node, ast.ImportFrom) else set()
        read = isinstance(node, ast.Attribute) and ast.unparse(node) in {
            "time.time",
            "time.time_ns",
        }
        naive = isinstance(node, ast.Call) and _is_now(node) and not (node.args or node.keywords)
        subtracted = isinstance(node, ast.BinOp) and isinstance(node.op, ast.Sub)
        subtracted = subtracted and any(map(_is_now, ast.walk(node)))
        if read or naive or subtracted or (imported and names & {"time", "time_ns"}):
            found.append(f"{path.name}:{getattr(node, 'lineno', 1)}: {ast.unparse(node)}")
    return found


def _is_now(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in {"now", "utcnow", "today"}
        and ast.unparse(node.func.value).rpartition(".")[2] in {"datetime", "date", "Timestamp"}
    )
