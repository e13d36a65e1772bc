"""Cost of the derivatives of a simulated motion, relative to the motion alone.

python -m experiments.benchmarks.sensitivities [--quick] [--output FOLDER]

The single-track car of `conf/problem/single_track`, 7 parameters: one evaluation (values), a batch
of 64 evaluations (values, batch), one evaluation with integrated sensitivities, and one evaluation
with central differences of the solver, which are 14 values in one batch. The fastest of many
alternating calls counts. A first use of a new model is the CPU time from the right-hand side to the
first values and sensitivities.
"""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from experiments.benchmarks.bars import Measured, at_most, benchmark, interleaved
from miho.models import Model
from miho.models.model import central_differences
from miho.quantities import Array
from miho.vehicle.data import steering_test
from miho.vehicle.models import single_track_response

CAR = {"mass": 800.0, "lf": 1.7, "lr": 1.271, "Izz": 850.0}
THETA = np.array([18.0, 1.5, 5500.0, 18.0, 1.5, 8000.0, 850.0])
ROWS = 300
BATCH = 64


def both(derivatives: Callable[..., Array], model: Model, *inputs: Array) -> None:
    """Compute values and derivatives at one configuration."""
    model.predict(THETA[None], *inputs)
    derivatives(THETA, *inputs)


def jobs_of(model: Model, inputs: tuple[Array, ...]) -> dict[str, Callable[[], Any]]:
    """The calls to measure, by name."""
    batch = np.tile(THETA, (BATCH, 1))
    return {
        "values": partial(model.predict, THETA[None], *inputs),
        "values, batch": partial(model.predict, batch, *inputs),
        "and sensitivities": partial(both, model.jacobian, model, *inputs),
        "and differences": partial(
            both, partial(central_differences, model.predict), model, *inputs
        ),
    }


def first_use(inputs: tuple[Array, ...]) -> float:
    """Milliseconds of CPU from the right-hand side to values and sensitivities."""
    start = time.process_time()
    model = single_track_response(CAR)
    both(model.jacobian, model, *inputs)
    return 1e3 * (time.process_time() - start)


def measure(quick: bool) -> Measured:
    """Measure a record of ROWS rows."""
    model, data = single_track_response(CAR), steering_test(CAR, duration=ROWS / 50)
    inputs = tuple(data[name] for name in model.inputs)
    seconds = interleaved(jobs_of(model, inputs), 20 if quick else 200)
    seconds["values, batch"] /= BATCH
    table = pd.DataFrame({"method": [*seconds], "us": [1e6 * value for value in seconds.values()]})
    table["evaluations"] = table["us"] / table["us"][0]
    first = min(first_use(inputs) for _ in range(5))
    ratio = seconds["and sensitivities"] / seconds["values"]
    bars = [at_most(f"with sensitivities, {ROWS} rows", ratio, 8, "evaluations")]
    alone = 1e3 * (seconds["and sensitivities"] - seconds["values"])
    notes = [
        f"a trajectory with its sensitivities alone: {alone:.2f} ms",
        f"a first use: {first:.1f} ms",
    ]
    return Measured(table, table, bars, notes)


if __name__ == "__main__":
    benchmark(__doc__, measure, "sensitivities")
