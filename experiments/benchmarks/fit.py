"""A fit from a script: `miho.fit` compared with SciPy's curve_fit, and lmfit if installed.

python -m experiments.benchmarks.fit [--quick] [--output FOLDER]

`miho.fit` searches a wide box without a start, also with a Huber loss and with a prior;
`miho.fit, start` and the others descend from a point 20 % from the optimum. They alternate. First
fits run in a separate process; their seconds are CPU time after `import miho`.
"""

import importlib
import json
import subprocess
import sys
from collections.abc import Callable
from functools import partial

import numpy as np
import pandas as pd

import miho
from experiments.benchmarks.bars import Measured, at_most, benchmark, turns
from miho.quantities import Array

ROWS, NOISE = 300, 0.05
TRUTH = {"a": 3.0, "b": 0.7, "c": 6.0, "d": 1.2, "e": 2.0}
BOX = {"a": (-20, 20), "b": (0.01, 20), "c": (0, 10), "d": (0.05, 10), "e": (-20, 20)}
PRIOR = {**BOX, "c": {"low": 0, "high": 10, "prior": (6.0, 0.1)}}
NEAR = {name: 1.2 * value for name, value in TRUTH.items()}

FIRST_FITS = """
import json, time
import numpy as np
import miho
from scipy.integrate import solve_ivp

t = np.linspace(0, 2, 50)
y = 2 * np.exp(-1.5 * t) + 0.05 * np.random.default_rng(1).standard_normal(50)
box = {"a": (0, 5), "b": (0, 10)}

def simulated(t, a, b):
    return solve_ivp(lambda _, u: -b * u, (0, 2), [a], t_eval=t).y[0]

def spent(model, **settings):
    started = time.process_time()
    miho.fit(model, t, y, box, **settings)
    return time.process_time() - started

print(json.dumps({
    "the README's": spent(lambda t, a, b: a * np.exp(-b * t)),
    "the same again": spent(lambda t, a, b: a * np.exp(-b * t)),
    "a second formula": spent(lambda t, a, b: a / (1 + b * t) ** 2),
    "compiled=False": spent(lambda t, a, b: a * np.exp(-b * t), compiled=False),
    "by solve_ivp": spent(simulated),
}))
"""


def bump(x: Array, a: float, b: float, c: float, d: float, e: float) -> Array:
    """A decay and a peak: five parameters, two of them linear."""
    return a * np.exp(-b * x) + e * np.exp(-(((x - c) / d) ** 2))


def measure(quick: bool) -> Measured:
    """Milliseconds of one fit."""
    rng = np.random.default_rng(0)
    x = np.linspace(0, 10, ROWS)
    y = bump(x, **TRUTH) + NOISE * rng.standard_normal(ROWS)
    seconds = turns(_jobs(x, y), 5 if quick else 30)
    rows = [{"form": name, "seconds": float(np.median(s))} for name, s in seconds.items()]
    frame = pd.DataFrame(rows)
    of = dict(zip(frame["form"], frame["seconds"], strict=True))
    bars = [
        at_most("miho.fit of 300 rows", 1e3 * of["miho.fit"], 4.0, "ms"),
        at_most("miho.fit from a start", 1e3 * of["miho.fit, start"], 1.0, "ms"),
        at_most("against curve_fit", of["miho.fit"] / of["curve_fit"], 5.0, "times"),
    ]
    if "lmfit" in of:
        bars.append(at_most("against lmfit", of["miho.fit"] / of["lmfit"], 1.0, "times"))
    notes = []
    first = first_fits()
    bars.append(at_most("the README's fit, first", first["the README's"], 0.3, "s of CPU"))
    notes.append("first fits, CPU s: " + ", ".join(f"{k} {v:.2f}" for k, v in first.items()))
    frame["speedup"] = of["curve_fit"] / frame["seconds"]
    return Measured(frame.assign(ms=1e3 * frame["seconds"])[["form", "ms"]], frame, bars, notes)


def first_fits() -> dict[str, float]:
    """CPU seconds of the first fits of a process."""
    command = [sys.executable, "-c", FIRST_FITS]
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    return dict(json.loads(process.stdout))


def _jobs(x: Array, y: Array) -> dict[str, Callable[[], object]]:
    """The fits to compare, by name."""
    optimize = importlib.import_module("scipy.optimize")
    jobs: dict[str, Callable[[], object]] = {
        "curve_fit": partial(optimize.curve_fit, bump, x, y, list(NEAR.values())),
        "miho.fit": partial(miho.fit, bump, x, y, BOX),
        "miho.fit, start": partial(miho.fit, bump, x, y, start=NEAR),
        "miho.fit, Huber": partial(miho.fit, bump, x, y, BOX, sigma=NOISE, loss="huber"),
        "miho.fit, a prior": partial(miho.fit, bump, x, y, PRIOR, sigma=NOISE),
        "miho.fit, by NumPy": partial(miho.fit, bump, x, y, BOX, compiled=False),
    }
    try:
        lmfit = importlib.import_module("lmfit")
    except ImportError:
        return jobs
    jobs["lmfit"] = partial(lmfit.Model(bump).fit, y, x=x, **NEAR)
    return jobs


if __name__ == "__main__":
    benchmark(__doc__, measure, "fit")
