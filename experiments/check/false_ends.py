"""How often the brackets of `miho_gn` agree on a wrong optimum, by how many of them have to agree.

python -m experiments.check.false_ends --instances 8 --seeds 2

Problems are drawn at random from families that have many optima: true parameters, rows and noise by
a seeded generator, boxes as wide as somebody would draw them who knows little. With one optimum
met, k brackets have to agree where one more is to find a better one with a probability of at most
1 / (k (k - 1)); the rule as it is stands at 7. A run ends wrongly if its loss is more than 0.1 %
above the best loss known: that of a descent from the true parameters, or of any run.
"""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from unittest.mock import patch

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import least_squares

from experiments.benchmarks.bars import machine
from miho import MIHOGN, Budget, CurveFit, Dataset, Parameter, Space, minimize
from miho.models import FunctionModel
from miho.study import single_thread

Array = NDArray[np.float64]
WRONG = 1e-3
BUDGET = Budget(evaluations=30_000)


@dataclass(frozen=True)
class Family:
    """A formula of columns and parameters; `draw` gives columns, true parameters and the noise."""

    formula: Callable[..., Array]
    box: tuple[tuple[float, float], ...]
    draw: Callable[[np.random.Generator], tuple[list[Array], list[float], float]]


def _peak(x: Array, c: Array, w: Array) -> Array:
    return np.exp(-(((x - c) / w) ** 2))


def _even(rng: np.random.Generator, fewest: int, most_points: int, end: float) -> list[Array]:
    return [np.linspace(0, end, int(rng.integers(fewest, most_points)))]


def _scattered(rng: np.random.Generator, fewest: int, most_points: int, end: float) -> list[Array]:
    return list(rng.uniform(0, end, (2, int(rng.integers(fewest, most_points)))))


U = np.random.Generator.uniform
PERIOD = (2.0, 200.0)
PEAK = ((0.0, 20.0), (0.0, 100.0), (0.5, 50.0))
FAMILIES = {
    "sine in noise": Family(
        lambda x, c, a, b, T: c + a * np.sin(2 * np.pi * x / T) + b * np.cos(2 * np.pi * x / T),
        ((-10, 10), (-5, 5), (-5, 5), PERIOD),
        lambda r: (_even(r, 40, 200, 100), [3, U(r, 0.5, 1.5), 0.3, U(r, 3, 30)], 1.0),
    ),
    "two sines": Family(
        lambda x, a, T, p, b, S, q: (
            a * np.sin(2 * np.pi * x / T + p) + b * np.sin(2 * np.pi * x / S + q)
        ),
        ((0, 5), (3, 60), (0, 6.3)) * 2,
        lambda r: (
            _even(r, 80, 300, 100), [1.5, U(r, 5, 30), 1, U(r, 0.4, 1), U(r, 3, 40), 2], 0.3
        ),
    ),
    "two peaks on a line": Family(
        lambda x, m, s, a, c, w, b, d, v: m + s * x + a * _peak(x, c, w) + b * _peak(x, d, v),
        ((-5, 5), (-0.1, 0.1), *PEAK, *PEAK),
        lambda r: (
            _even(r, 60, 300, 100),
            [1, 0.02, U(r, 2, 5), U(r, 10, 45), U(r, 2, 8), U(r, 0.5, 4), U(r, 55, 90), U(r, 2, 8)],
            0.3,
        ),
    ),
    "three peaks": Family(
        lambda x, a, c, w, b, d, v, e, g, u: (
            a * _peak(x, c, w) + b * _peak(x, d, v) + e * _peak(x, g, u)
        ),
        PEAK * 3,
        lambda r: (
            _even(r, 100, 300, 100),
            [U(r, 2, 5), U(r, 10, 35), U(r, 2, 8), U(r, 0.5, 4), U(r, 40, 65), U(r, 2, 8),
             U(r, 0.5, 4), U(r, 70, 95), U(r, 2, 8)],
            0.1,
        ),
    ),
    "a bump in a plane": Family(
        lambda x, z, m, s, t, a, c, d, w: m + s * x + t * z + a * _peak(x, c, w) * _peak(z, d, w),
        ((-5, 5), (-5, 5), (-5, 5), (0, 10), (0, 1), (0, 1), (0.01, 1)),
        lambda r: (
            _scattered(r, 200, 600, 1),
            [1, 1, -1, U(r, 1, 4), U(r, 0.1, 0.9), U(r, 0.1, 0.9), U(r, 0.05, 0.2)],
            0.3,
        ),
    ),
    "a plane wave": Family(
        lambda x, z, m, a, k, h, p: m + a * np.sin(k * x + h * z + p),
        ((-5, 5), (0, 5), (0, 6), (0, 6), (0, 6.3)),
        lambda r: (_scattered(r, 100, 500, 10), [0, 1, U(r, 1, 5), U(r, 1, 5), 1], 0.5),
    ),
    "a damped oscillation": Family(
        lambda x, a, g, h, p, m: m + a * np.exp(-g * x) * np.sin(2 * np.pi * h * x + p),
        ((0, 10), (0, 5), (0.1, 6), (0, 6.3), (-2, 2)),
        lambda r: (_even(r, 60, 300, 10), [2, U(r, 0.1, 0.8), U(r, 0.5, 4), 1, 0], 0.3),
    ),
    "two decays": Family(
        lambda x, a, k, b, h, m: m + a * np.exp(-k * x) + b * np.exp(-h * x),
        ((-10, 10), (0, 10), (-10, 10), (0, 10), (-5, 5)),
        lambda r: (_even(r, 30, 150, 10), [2, U(r, 0.1, 0.5), 1, U(r, 1, 5), 0.2], 0.05),
    ),
}  # fmt: skip


def problem(family: Family, rng: np.random.Generator) -> tuple[CurveFit, float]:
    """A problem of a family, and the loss of a descent from its true parameters."""
    columns, true, noise = family.draw(rng)
    names = family.formula.__code__.co_varnames[: len(columns) + len(true)]
    inputs, parameters = names[: len(columns)], names[len(columns) :]
    y = family.formula(*columns, *true) + noise * rng.normal(size=columns[0].size)
    dataset = Dataset(
        "drawn", {**dict(zip(inputs, columns, strict=True)), "y": y},
        dict.fromkeys((*inputs, "y"), "-"), "y",
    )  # fmt: skip
    space = Space(
        tuple(
            Parameter(name, "-", low, high)
            for name, (low, high) in zip(parameters, family.box, strict=True)
        )
    )
    fit = CurveFit(_function(family.formula, inputs, parameters), dataset, space)
    start = np.clip(np.array(true, dtype=float), space.low, space.high)
    descent = least_squares(
        fit.residuals, start, bounds=(space.low, space.high), x_scale=space.high - space.low
    )
    return fit, 2 * float(descent.cost) / y.size


def _function(
    formula: Callable[..., Array], inputs: tuple[str, ...], parameters: tuple[str, ...]
) -> FunctionModel:
    """A model of the formula, with what says which arguments are inputs and which parameters."""

    def function(*columns: Array, **values: Array) -> Array:
        return formula(*columns, **values)

    column, value = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.KEYWORD_ONLY
    function.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [inspect.Parameter(name, column, annotation="-") for name in inputs]
        + [inspect.Parameter(name, value, annotation="-") for name in parameters],
        return_annotation="-",
    )
    return FunctionModel(function)


def runs(instances: int, seeds: int, agreeing: list[int]) -> Iterator[dict[str, object]]:
    """A row per run: family, instance, how many have to agree, loss, evaluations, how it ended."""
    for number, (name, family) in enumerate(FAMILIES.items()):
        for instance in range(instances):
            fit, known_loss = problem(family, np.random.default_rng([number, instance]))
            for k in agreeing:
                better, enough = 1 / (k * (k - 1)) + 1e-9, min(k, 5)
                with (
                    patch("miho.optim.evidence.BETTER", better),
                    patch("miho.optim.evidence.ENOUGH", enough),
                    single_thread(),
                ):
                    for seed in range(seeds):
                        run = minimize(MIHOGN(), fit, BUDGET, seed)
                        yield {
                            "family": name, "instance": instance, "agreeing": k,
                            "known": known_loss, "loss": run.loss, "evaluations": run.evaluations,
                            "ended": str(run.outcome) == "converged",
                        }  # fmt: skip


def main() -> None:
    """Draw, run, print."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.check.false_ends",
        description=(__doc__ or "").partition("\n\n")[0],
    )
    parser.add_argument("--instances", type=int, default=8, help="problems of each family")
    parser.add_argument("--seeds", type=int, default=2, help="runs on each")
    parser.add_argument("--agreeing", default="4,5,7,10", help="how many brackets have to agree")
    arguments = parser.parse_args()
    print(machine())
    agreeing = [int(text) for text in arguments.agreeing.split(",")]
    table = pd.DataFrame(list(runs(arguments.instances, arguments.seeds, agreeing)))
    best = table.groupby(["family", "instance"])["loss"].transform("min")
    best = best.where(best < table["known"], table["known"])
    table["wrong"] = table["ended"] & (table["loss"] > (1 + WRONG) * best)
    for keys in (["family", "agreeing"], ["agreeing"]):
        summary = table.groupby(keys, sort=False).agg(
            runs=("ended", "size"), ended=("ended", "sum"), wrong=("wrong", "sum"),
            evaluations=("evaluations", "median"),
        )  # fmt: skip
        print(summary.round(0).to_string(), "\n")


if __name__ == "__main__":
    main()
