"""Which disturbances of a timed run are found, and that an undisturbed one is let be."""

import json
import math
from dataclasses import replace

import pytest

from miho.study import contention, environment_stamp, single_thread
from miho.study.contention import Counters, ReferenceWork, Stamp, stamped
from miho.study.environment import machine_seconds

CALM = Counters(wall=100.0, cpu=50.0, switches=7, machine=1000.0, load=0.5)


class Scripted:
    """Counters and fixed work as the test says, in place of the machine's."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, end: Counters, after: float = 1.0) -> None:
        readings = iter([CALM, end])
        pools = [{"num_threads": 1}]
        work = ReferenceWork()
        monkeypatch.setattr(contention.Counters, "now", lambda: next(readings))
        measured = iter([1.0, after])
        monkeypatch.setattr(work, "recent", lambda: next(measured))
        monkeypatch.setattr(contention, "reference_work", lambda: work)
        monkeypatch.setattr(
            contention, "library_threads", lambda: [pool["num_threads"] for pool in pools]
        )
        monkeypatch.setattr(contention.os, "cpu_count", lambda: 2)
        self.pools = pools

    def stamp(self) -> Stamp:
        with stamped() as stamp:
            pass
        return stamp


def after(seconds: float, **counters: float) -> Counters:
    """A second reading, this much later, of a process that had a core to itself."""
    calm = replace(CALM, wall=CALM.wall + seconds, cpu=CALM.cpu + seconds, machine=1000.0 + seconds)
    return replace(calm, **counters)  # type: ignore[arg-type]


def test_an_undisturbed_run_is_valid(monkeypatch: pytest.MonkeyPatch) -> None:
    timing = Scripted(monkeypatch, after(10.0, switches=50)).stamp().judge(9.0, 8.99)
    assert timing.valid
    assert (timing.interruptions, timing.others, timing.threads) == (43, 0.0, (1,))
    assert timing.cpu_share == pytest.approx(8.99 / 9)


@pytest.mark.parametrize(
    ("seconds", "cpu_seconds", "valid"),
    [
        (10.0, 9.6, True),
        (10.0, 9.4, False),
        (0.004, 0.0025, True),
        (0.004, 0.0015, False),
        (1.0, 1.9, False),
        (0.0, 0.0, True),
    ],
)
def test_a_run_has_one_core(
    monkeypatch: pytest.MonkeyPatch, seconds: float, cpu_seconds: float, valid: bool
) -> None:
    """5 % of its seconds, or 2 ms if that is more, may differ from its CPU time."""
    timing = Scripted(monkeypatch, after(10.0)).stamp().judge(seconds, cpu_seconds)
    assert timing.valid == valid


@pytest.mark.parametrize(
    ("end", "reason"),
    [
        (after(1.0, switches=7 + 34), "other work interrupted it 34 times in 1 s"),
        (after(1.0, machine=1000.0 + 2.2), "other work kept 1.2 of 2 cores busy"),
        (after(1.0, machine=1000.0 + 1.9), None),
        (after(0.1, machine=1000.0 + 0.9), None),
        (after(1.0, load=9.0), None),
    ],
)
def test_other_work(monkeypatch: pytest.MonkeyPatch, end: Counters, reason: str | None) -> None:
    """Short runs are not judged by counters of 10 ms, and no run by the last minute's load."""
    timing = Scripted(monkeypatch, end).stamp().judge(0.1, 0.1)
    assert timing.reasons == ((reason,) if reason else ())


def test_load_counts_where_nothing_better_does(monkeypatch: pytest.MonkeyPatch) -> None:
    scripted = Scripted(monkeypatch, after(1.0, load=2.5))
    monkeypatch.setattr(contention, "machine_seconds", lambda: None)
    reasons = scripted.stamp().judge(1.0, 1.0).reasons
    assert reasons == ("the load average was 2.5 on 2 cores",)


def test_a_slower_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    timing = Scripted(monkeypatch, after(1.0), after=1.4).stamp().judge(1.0, 1.0)
    assert timing.reasons == ("fixed work after it took 1.40 times as long as at best",)


def test_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    scripted = Scripted(monkeypatch, after(1.0))
    scripted.pools.append({"num_threads": 4})
    timing = scripted.stamp().judge(1.0, 1.0)
    assert timing.reasons == ("a numerical library had 4 threads; expected 1",)


def test_it_goes_into_a_json_file() -> None:
    with single_thread(), stamped() as stamp:
        pass
    timing = stamp.judge(0.0, 0.0)
    read = json.loads(json.dumps(timing.as_dict(), allow_nan=False))
    assert read["reasons"] == list(timing.reasons)
    assert read["kernel"] == list(timing.kernel)
    assert set(read["threads"]) <= {1}
    assert read["valid"] == (not read["reasons"])
    assert set(read) >= {"load", "others", "interruptions", "cpu_share", "kernel"}


def test_fixed_work_is_relative_to_its_best_and_used_again_while_fresh() -> None:
    work = ReferenceWork()
    assert work.measure() == 1.0
    best = work.best
    assert 1e-5 < best < 0.1
    work.best = best / 2
    assert work.recent() == work.last / work.best == pytest.approx(2.0)
    work.at -= 1.0
    last = work.last
    work.recent()
    assert work.last != last


def test_the_counters_rise() -> None:
    before = Counters.now()
    math.fsum(range(200_000))
    later = Counters.now()
    assert later.wall > before.wall
    assert later.cpu > before.cpu
    assert later.switches >= before.switches


def test_the_work_of_all_cores_is_counted() -> None:
    if machine_seconds() is None:
        pytest.skip("this system has no /proc/stat")
    spent = machine_seconds()
    assert spent is not None
    assert spent > 0
    assert environment_stamp()["cores"] >= 1
