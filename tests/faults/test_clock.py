"""R9: a wall clock that leaps."""

import time
from pathlib import Path

import numpy as np
import pytest

from experiments.faults.clock import clock, leaping_wall_clock, simulated_run, wall_clock_uses
from miho.optim import Clock, oracle


def test_it_is_met(tmp_path: Path) -> None:
    row = clock(tmp_path)
    assert row.met, row.measured


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
            "experiments.faults.clock.Clock", lambda wall, cpu: Clock(lambda: time.time(), cpu)
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
