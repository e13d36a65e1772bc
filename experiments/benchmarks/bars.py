"""Common parts of the benchmarks of speed: machine, table, bars with a verdict, optional files."""

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from experiments.app.console import BUG, OK, run_and_exit
from miho.analysis import save
from miho.study import environment_stamp, single_thread, write_text
from miho.study.provenance import command_line


@dataclass(frozen=True)
class Bar:
    """A measured value, a limit and the `relation` that must hold between them."""

    name: str
    measured: float
    relation: str
    limit: float
    unit: str = ""

    @property
    def met(self) -> bool:
        """Whether the value keeps to the limit; NaN does not."""
        if self.relation == "<=":
            return self.measured <= self.limit
        return self.measured >= self.limit

    def __str__(self) -> str:
        verdict = "met" if self.met else "MISSED"
        comparison = f"{self.measured:.3g} {self.relation} {self.limit:g} {self.unit}".rstrip()
        return f"{verdict:<7} {self.name}: {comparison}"


def at_most(name: str, measured: float, limit: float, unit: str = "") -> Bar:
    """A value that may not exceed its limit."""
    return Bar(name, measured, "<=", limit, unit)


def at_least(name: str, measured: float, limit: float, unit: str = "") -> Bar:
    """A value that must reach its limit."""
    return Bar(name, measured, ">=", limit, unit)


@dataclass(frozen=True)
class Measured:
    """The result of a benchmark; `tidy` has a row per measurement, `table` is printed."""

    table: pd.DataFrame
    tidy: pd.DataFrame
    bars: Sequence[Bar]
    notes: Sequence[str] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)
    """Other facts about the measurement: seeds, settings."""


def benchmark(
    doc: str | None,
    measure: Callable[..., Measured],
    name: str,
    flags: Mapping[str, str] | None = None,
    options: Mapping[str, tuple[Any, str]] | None = None,
    *,
    draw: Callable[[pd.DataFrame], Figure] | None = None,
) -> None:
    """Measure on one pinned thread, print, and exit with 1 if a bar is missed.

    `measure` is called with `quick` and with a value for each of the `flags`, a mapping of names to
    help texts, and of the `options`, a mapping of names to default and help text. Files are written
    only with `--output FOLDER`.
    """
    parser = argparse.ArgumentParser(description=(doc or "").strip().splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="smaller sizes and fewer repeats")
    parser.add_argument("--output", type=Path, help="folder for CSV, JSON and, if any, a figure")
    for flag, text in (flags or {}).items():
        parser.add_argument(f"--{flag}", action="store_true", help=text)
    for option, (default, text) in (options or {}).items():
        parser.add_argument(f"--{option}", type=type(default), default=default, help=text)
    arguments = parser.parse_args()
    chosen = {name: getattr(arguments, name) for name in (*(flags or {}), *(options or {}))}
    bars: list[Bar] = []

    def job() -> int:
        print(machine())
        started = time.perf_counter()
        with single_thread():
            measured = measure(arguments.quick, **chosen)
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
            _write(arguments.output / f"{name}.json", name, measured)
            if draw is not None:
                save(draw(measured.tidy), arguments.output / name)
        return OK if all(bar.met for bar in bars) else BUG

    run_and_exit(job)


def shown(rows: Iterable[Mapping[str, Any]]) -> Iterator[Mapping[str, Any]]:
    """Yield the rows of a benchmark that takes minutes, and print each to stderr."""
    for row in rows:
        line = ", ".join(f"{key} {value}" for key, value in row.items() if value == value)
        print(line, file=sys.stderr, flush=True)
        yield row


def _write(path: Path, name: str, measured: Measured) -> None:
    """Write the numbers, the bars and the conditions of the measurement."""
    about = {
        "command": command_line(f"experiments.benchmarks.{name}"),
        **measured.facts,
        "bars": [
            {**asdict(bar), "measured": float(bar.measured), "met": bool(bar.met)}
            for bar in measured.bars
        ],
        "notes": list(measured.notes),
        "environment": environment_stamp(),
        "rows": [],
    }
    rows = json.loads(measured.tidy.to_json(orient="records", double_precision=15))
    lines = ",\n".join(f"  {json.dumps(row)}" for row in rows)  # one line per row
    text = json.dumps(about, indent=1).removesuffix("[]\n}")
    write_text(path, f"{text}[\n{lines}\n ]\n}}\n")


def machine() -> str:
    """Processor, versions and load, in one line."""
    stamp = environment_stamp()
    load = f"load {stamp['load'][0]:.1f}" if stamp["load"] else "load unknown"
    return (
        f"{stamp['processor']}, {stamp['cores']} cores, {load}, Python {stamp['python']}, "
        f"numpy {version('numpy')}"
    )


def turns(
    jobs: Mapping[str, Callable[[], object]], repeats: int, atom: float = 0.01
) -> dict[str, list[float]]:
    """Seconds of one call of each job in each turn; the jobs alternate.

    A measurement repeats the call for `atom` seconds, so that the cost of the clock is negligible;
    slower jobs are called once per turn.
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
    """Smallest seconds of one call of each job; the jobs alternate."""
    return {name: min(seconds) for name, seconds in turns(jobs, repeats, atom).items()}
