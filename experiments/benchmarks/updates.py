"""Updates of a tracker: their time, their memory, and the way to another process and back.

python -m experiments.benchmarks.updates [--quick] [--output FOLDER]

One tracker follows a tire, which has five parameters and one output; another one follows twelve
parameters by three outputs that depend on all of them. The first one then takes a million rows. A
client sends lines of JSON to `experiments.track` and waits for each state. The worst time counts
interruptions by other processes too.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from typing import IO, Any, cast

import numpy as np
import pandas as pd

import miho
from baselines.online import tire
from experiments.benchmarks.bars import Measured, at_most, benchmark
from experiments.benchmarks.online_records import arguments
from miho.quantities import Array

SEED, UPDATES, LINES = 0, 100_000, 1000
SINES = [f"a{k}" for k in range(1, 13)]
Row = Mapping[str, float]


def sines(shift: float) -> Callable[..., Any]:
    """The sum of twelve sines with unknown amplitudes."""

    def total(
        x: Any, *, a1: Any, a2: Any, a3: Any, a4: Any, a5: Any, a6: Any,
        a7: Any, a8: Any, a9: Any, a10: Any, a11: Any, a12: Any,
    ) -> Any:  # fmt: skip
        amplitudes = a1, a2, a3, a4, a5, a6, a7, a8, a9, a10, a11, a12
        return sum(a * np.sin((k + shift) * x) for k, a in enumerate(amplitudes, 1))

    return total


def wide_tracker(count: int) -> tuple[miho.Tracker, list[Row]]:
    """A tracker of twelve parameters by three outputs, and its rows."""
    rng = np.random.default_rng(SEED)
    x = rng.uniform(0, 3, count)
    space = miho.Space(tuple(miho.Parameter(name, "", -5, 5) for name in SINES))
    columns: dict[str, Any] = {"time": 0.02 * np.arange(count), "x": x}
    problems = []
    for shift, name in enumerate("uvw"):
        model = miho.models.FunctionModel(sines(shift / 3))
        columns[name] = model.predict(np.ones((1, 12)), x)[0] + rng.normal(0, 0.1, count)
        data = miho.Dataset(name, {"x": x, name: columns[name]}, {"x": "", name: ""}, name)
        problems.append(miho.CurveFit(model, data, space, sigma=0.1))
    numbers = zip(*columns.values(), strict=True)
    rows: list[Row] = [dict(zip(columns, each, strict=True)) for each in numbers]
    return miho.Tracker(problems, dict.fromkeys(SINES, (1.0, 0.1))), rows


def seconds_of(update: Callable[[Any], Any], rows: Iterable[Any]) -> Array:
    """The time of each update [s]."""
    seconds = []
    for row in rows:
        started = time.perf_counter()
        update(row)
        seconds.append(time.perf_counter() - started)
    return np.array(seconds)


def endless(rows: Sequence[Row]) -> Iterator[Row]:
    """The rows again and again, at later times."""
    past = 0.0
    while True:
        for row in rows:
            yield {**row, "time": row["time"] + past}
        past += rows[-1]["time"] + 0.02


def answers(count: int) -> Array:
    """Seconds from a line of JSON to the line of its state, for a client in another process."""
    axle = tire("mixed", SEED, 0.02 * (count + 1)).columns
    values = zip(axle["time"], axle["alpha"], axle["Fy"], strict=True)
    lines = [json.dumps(dict(zip(("time", "alpha", "Fy"), each, strict=True))) for each in values]
    command = [sys.executable, "-m", "experiments.track", "dataset=front_axle"]
    with (
        tempfile.TemporaryDirectory() as folder,
        subprocess.Popen(
            [*command, f"root={folder}"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, text=True, bufsize=1,
        ) as process,
    ):  # fmt: skip
        to, back = cast("IO[str]", process.stdin), cast("IO[str]", process.stdout)

        def ask(line: str) -> None:
            to.write(line + "\n")
            if "error" in json.loads(back.readline()):
                raise RuntimeError(f"no state for {line}")

        ask(lines[0])  # the answer waits for the fit of the prior
        seconds = seconds_of(ask, lines[1:])
        to.close()
    return seconds


def measure(quick: bool) -> Measured:
    """Measure both trackers, a million rows, and a client."""
    share = 20 if quick else 1
    stream = tire("mixed", SEED, 0.02 * UPDATES / share)
    run, rows = miho.Tracker(**arguments(stream)), list(stream)
    small = 1e6 * seconds_of(run.update, rows)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for row in islice(endless(rows), 10 * UPDATES // share):
        run.update(row)
    growth = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    other, others = wide_tracker(UPDATES // 10 // share)
    wide = 1e6 * seconds_of(other.update, others)
    client = 1e6 * answers(LINES // share)
    each = {"5 parameters, 1 output": small, "12 parameters, 3 outputs": wide, "a client": client}
    frame = pd.DataFrame([
        {"name": name, "updates": us.size, "median us": np.median(us),
         "99 % us": np.quantile(us, 0.99), "worst us": us.max()}
        for name, us in each.items()
    ])  # fmt: skip
    bars = [
        at_most("5 parameters, median", float(np.median(small)), 50, "us"),
        at_most("5 parameters, 99 %", float(np.quantile(small, 0.99)), 200, "us"),
        at_most("5 parameters, worst", small.max(), 5000, "us"),
        at_most("12 parameters, 3 outputs, median", float(np.median(wide)), 500, "us"),
        at_most("more memory after 10 times the rows", growth, 1000, "kB"),
        at_most("a client, 99 %", float(np.quantile(client, 0.99)), 5000, "us"),
    ]
    return Measured(frame, frame, bars, facts={"seed": SEED})


if __name__ == "__main__":
    benchmark(__doc__, measure, "updates")
