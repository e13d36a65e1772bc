"""What every benchmark of speed does alike: machine, table, bars with a verdict, files if asked."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from experiments.app.console import BUG, OK, run_and_exit
from miho.analysis import save
from miho.study import environment_stamp, single_thread

AT_MOST, AT_LEAST = "<=", ">="


@dataclass(frozen=True)
class Bar:
    """A limit, `relation` to which the measured value must stand."""

    name: str
    measured: float
    relation: str
    limit: float
    unit: str = ""

    @property
    def met(self) -> bool:
        """Whether the value keeps to the limit; one that is not a number does not."""
        if self.relation == AT_MOST:
            return self.measured <= self.limit
        return self.measured >= self.limit

    def __str__(self) -> str:
        verdict = "met" if self.met else "MISSED"
        comparison = f"{self.measured:.3g} {self.relation} {self.limit:g} {self.unit}".rstrip()
        return f"{verdict:<7} {self.name}: {comparison}"


@dataclass(frozen=True)
class Measured:
    """The result of a benchmark; `tidy` has a row per measurement, `table` is what people read."""

    table: pd.DataFrame
    tidy: pd.DataFrame
    bars: Sequence[Bar]
    notes: Sequence[str] = ()


def benchmark(
    doc: str | None,
    measure: Callable[[bool], Measured],
    draw: Callable[[pd.DataFrame], Figure],
    name: str,
) -> None:
    """Measure on one pinned thread, print, and exit with 1 if a bar is missed.

    `measure` gets whether to be quick. Nothing is written unless `--output FOLDER` is given.
    """
    parser = argparse.ArgumentParser(description=(doc or "").strip().splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="smaller sizes and fewer repeats")
    parser.add_argument("--output", type=Path, help="folder for a table (CSV) and a figure")
    arguments = parser.parse_args()
    bars: list[Bar] = []

    def job() -> int:
        print(machine())
        started = time.perf_counter()
        with single_thread():
            measured = measure(arguments.quick)
        bars.extend(measured.bars)
        print(f"\n{measured.table.to_string(index=False, float_format='{:.4g}'.format)}\n")
        for note in measured.notes:
            print(note)
        print(f"{'quick, ' * arguments.quick}{time.perf_counter() - started:.0f} s in all\n")
        for bar in bars:
            print(bar)
        if arguments.output is not None:
            arguments.output.mkdir(parents=True, exist_ok=True)
            measured.tidy.to_csv(arguments.output / f"{name}.csv", index=False)
            save(draw(measured.tidy), arguments.output / name)
        return OK if all(bar.met for bar in bars) else BUG

    run_and_exit(job)


def machine() -> str:
    """Processor, versions and load, in one line."""
    stamp = environment_stamp()
    load = f"load {stamp['load'][0]:.1f}" if stamp["load"] else "load unknown"
    return (
        f"{stamp['processor']}, {stamp['cores']} cores, {load}, Python {stamp['python']}, "
        f"numpy {version('numpy')}, numba {version('numba')}"
    )


def turns(
    jobs: Mapping[str, Callable[[], object]], repeats: int, atom: float = 0.01
) -> dict[str, list[float]]:
    """Seconds of one call of each job, once for each of the turns that they take.

    A measurement is as many calls as `atom` seconds hold, so that the clock's own cost is lost in
    it; jobs slower than that are called once a turn.
    """
    calls: dict[str, int] = {}
    for name, job in jobs.items():
        job()
        started = time.perf_counter()
        job()
        calls[name] = max(1, int(atom / max(time.perf_counter() - started, 1e-9)))
    seconds: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(repeats):
        for name, job in jobs.items():
            started = time.perf_counter()
            for _ in range(calls[name]):
                job()
            seconds[name].append((time.perf_counter() - started) / calls[name])
    return seconds


def interleaved(
    jobs: Mapping[str, Callable[[], object]], repeats: int, atom: float = 0.01
) -> dict[str, float]:
    """Smallest seconds of one call of each job, taken in turns."""
    return {name: min(seconds) for name, seconds in turns(jobs, repeats, atom).items()}
