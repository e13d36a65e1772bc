"""Distance between the optimum of the first rows and of all rows, for several orders of the rows.

python -m experiments.check.row_order [--orders 20] [--problems tire_lf,rare_load]

For the first 4, 12 and 36 rows per parameter, least squares on them starts from the optimum of all
rows. The table has the increase of the loss over all rows at its end, in percent: the median and
the 90 % quantile over `--orders` orders. `seen` is the share of orders whose first 4 rows per
parameter have derivatives of full rank. The orders are: random; by rank, a low-discrepancy sequence
over the sorted first input; by value, covering rows first; alternating, with every second row a
covering one; and the order in use, with sqrt(m) covering rows among m. In the synthetic problems,
one row in a hundred determines a parameter (rare), inputs are clustered, skewed over six decades,
constant or repeat a few values, or the model is wrong where rows are rare (wrong). Some results (20
orders):

                            seen at 4 d rows        median percent more loss at 36 d rows
                         rare        rare_load      rare_load   skewed    wrong    tire_lf
    random               0.10           0.10           2.3        1.5       3.6       1.4
    by rank              0.10           0.15           3.4        1.6       2.0       2.0
    by value             1.00           1.00           1.0        559      63.4       1.9
    alternating          1.00           1.00           1.3        6.7      59.6       1.9
    in use               1.00           1.00           1.8        1.5       8.6       1.4

If all or half of the first rows are covering rows, a wrong model fits the rare rows too closely.
"""

# ruff: noqa: F722
# mypy: disable-error-code="valid-type"
# Units of functions are strings in their annotations.

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from experiments.app.build import build_problem
from experiments.app.compose import composed
from experiments.app.console import run_and_exit
from experiments.app.schema import register
from miho.data import Dataset
from miho.identification import CurveFit
from miho.identification.row_order import covering_rows, merged, row_order
from miho.models import FunctionModel
from miho.optim import Parameter, Space
from miho.optim.seeds import stream
from miho.quantities import Array
from miho.study import single_thread

Rows = NDArray[np.intp]

PER_PARAMETER = (4, 12, 36)
ROWS = 3000
RARE = 0.01
ARENA = (
    "sample_a_physical", "tire_lf", "mf61_lateral", "brake_static", "front_axle", "heavy_tails",
    "nan_region",
)  # fmt: skip
SINGULAR = 1e-6
"""Ratio of the singular values of columns of length 1 below which the rank is not full."""


def by_rank(inputs: Sequence[Array], rng: np.random.Generator) -> Rows:
    """Steps of the golden ratio through the sorted first input that varies."""
    column = max(inputs, key=lambda column: float(np.ptp(column)) > 0)
    start = rng.random() + np.arange(column.size) * (np.sqrt(5) - 1) / 2
    return np.argsort(column, kind="stable")[np.argsort(np.argsort(start % 1.0))]


def by_value(inputs: Sequence[Array], rng: np.random.Generator) -> Rows:
    """Covering rows first."""
    order = rng.permutation(inputs[0].size)
    covering = covering_rows(inputs, order, order.size // 2, rng)
    return merged(order, covering, np.arange(covering.size))


def alternating(inputs: Sequence[Array], rng: np.random.Generator) -> Rows:
    """Covering and random rows in turn."""
    order = rng.permutation(inputs[0].size)
    covering = covering_rows(inputs, order, order.size // 2, rng)
    return merged(order, covering, 2 * np.arange(covering.size))


ORDERS: dict[str, Callable[[Sequence[Array], np.random.Generator], Rows]] = {
    "random": lambda inputs, rng: rng.permutation(inputs[0].size),
    "by rank": by_rank,
    "by value": by_value,
    "alternating": alternating,
    "in use": row_order,
}


def decay(x: "-", *, a: "-", b: "-", c: "-") -> "-":
    """A decay towards a constant."""
    return a * np.exp(-b * x) + c


def rare_slope(x: "-", *, a: "-", b: "-", q: "-") -> "-":
    """A decay, and a line that begins at 0.8."""
    return a * np.exp(-b * x) + q * np.maximum(x - 0.8, 0)


def rare_load(x: "-", z: "-", *, B: "-", C: "-", D: "-", q: "-", S: "-") -> "-":
    """The sine of an arctangent, times a load z whose effect falls above 5."""
    return D * z * np.sin(C * np.arctan(B * x)) * (1 - q * np.maximum(z - 5, 0)) + S


def saturation(x: "-", *, a: "-", b: "-", c: "-") -> "-":
    """A square root that saturates."""
    return a * np.sqrt(x) / (b + np.sqrt(x)) + c


def line(x: "-", *, a: "-", b: "-") -> "-":
    """A straight line."""
    return a + b * x


def scaled_decay(x: "-", z: "-", *, a: "-", b: "-", c: "-") -> "-":
    """A decay times another input."""
    return a * z * np.exp(-b * x) + c


SYNTHETIC: dict[str, tuple[Callable[..., Array], tuple[float, ...], float]] = {
    "rare": (rare_slope, (1.0, 2.0, 3.0), 0.02),
    "rare_load": (rare_load, (12.0, 1.4, 1.0, 0.08, 0.05), 0.1),
    "clusters": (decay, (1.0, 8.0, 0.2), 0.02),
    "skewed": (saturation, (2.0, 3.0, 0.2), 0.02),
    "constant": (scaled_decay, (1.0, 3.0, 0.2), 0.05),
    "sorted": (decay, (1.0, 8.0, 0.2), 0.05),
    "duplicates": (decay, (1.0, 4.0, 0.2), 0.05),
    "wrong": (line, (0.0, 1.0), 0.05),
}
"""Synthetic problems: function, parameters and the noise's standard deviation."""


def inputs_of(name: str, rng: np.random.Generator) -> tuple[Array, ...]:
    """The inputs of a synthetic problem."""
    u, v = rng.random((2, ROWS))
    rare = rng.random(ROWS) < RARE
    return {
        "rare": (np.where(rare, 0.85 + 0.15 * u, 0.8 * u),),
        "rare_load": (0.4 * v - 0.2, np.where(rare, 6 + 2 * u, 1 + 3 * u)),
        "clusters": (rng.choice([0.1, 0.15, 0.9], ROWS) + 0.005 * (u - 0.5),),
        "skewed": (10 ** (6 * u - 3),),
        "constant": (u, np.ones(ROWS)),
        "sorted": (np.linspace(0, 1, ROWS),),
        "duplicates": (np.floor(12 * u**3) / 12,),
        "wrong": (np.clip(0.5 + 0.12 * rng.standard_normal(ROWS), 0, 1),),
    }[name]


def synthetic(name: str) -> CurveFit:
    """A synthetic problem; `wrong` has a cubic part that its model lacks."""
    function, truth, noise = SYNTHETIC[name]
    rng = stream("row order", name)
    inputs = inputs_of(name, rng)
    model = FunctionModel(function)
    y = model.predict(np.array([truth]), *inputs)[0] + noise * rng.standard_normal(ROWS)
    if name == "wrong":
        y = y + 6 * (inputs[0] - 0.5) ** 3
    columns = {**dict(zip(model.inputs, inputs, strict=True)), "y": y}
    data = Dataset(name, columns, dict.fromkeys(columns, "-"), "y")
    space = Space(tuple(Parameter(p, "-", -20.0, 20.0) for p in model.parameters))
    return CurveFit(model, data, space, label=name)


def descended(problem: CurveFit, theta: Array, rows: Rows | slice = slice(None)) -> Array:
    """End of bounded least squares on some rows from `theta` (d,)."""
    low, high = problem.space.low, problem.space.high
    inputs = tuple(column[rows] for column in problem.inputs)
    output = problem.dataset[problem.dataset.output][rows]

    def residuals(theta: Array) -> Array:
        values = problem.model.predict(theta[None], *inputs)[0] - output
        return problem.rho.transform(values)

    inside = np.clip(theta, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
    return np.asarray(
        scipy.optimize.least_squares(
            residuals, inside, bounds=(low, high), x_scale="jac", max_nfev=60
        ).x
    )


def optimum(name: str, problem: CurveFit) -> Array:
    """Optimum over all rows: from the truth, or the best end from screened starting points."""
    if name in SYNTHETIC:
        return descended(problem, np.array(SYNTHETIC[name][1]))
    thetas = problem.space.decode(problem.space.initial(500))
    starts = thetas[np.argsort(problem.loss(thetas))[:10]]
    ends = np.array([descended(problem, theta) for theta in starts])
    return np.asarray(ends[problem.loss(ends).argmin()])


def full_rank(problem: CurveFit, theta: Array, rows: Rows) -> bool:
    """Whether the derivatives of these rows have full rank."""
    jacobian = problem.model.jacobian(theta, *(column[rows] for column in problem.inputs))
    whole = problem.model.jacobian(theta, *problem.inputs)
    size = np.sqrt(np.mean(whole**2, axis=0) * rows.size)
    singular = np.linalg.svd(jacobian / np.where(size > 0, size, 1.0), compute_uv=False)
    return bool(singular[-1] > SINGULAR * singular[0])


def figures(
    name: str, problem: CurveFit, best: Array, kind: str, orders: int
) -> tuple[list[bool], list[Array]]:
    """For each order: whether its first rows have full rank, and the increase of the loss [%]."""
    d, least = len(problem.space), problem.loss(best[None])[0]
    full, losses = [], []
    for seed in range(orders):
        order = ORDERS[kind](problem.inputs, stream("order", name, seed))
        full.append(full_rank(problem, best, order[: 4 * d]))
        ends = np.array([descended(problem, best, order[: k * d]) for k in PER_PARAMETER])
        losses.append(100 * (problem.loss(ends) / least - 1))
    return full, losses


def main() -> None:
    """Print one line per problem and order."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--orders", type=int, default=20, help="orders of each kind")
    parser.add_argument("--problems", default=",".join((*SYNTHETIC, *ARENA)))
    arguments = parser.parse_args()

    def job() -> None:
        register()
        sizes = "".join(f"{f'{k} d rows':>22}" for k in PER_PARAMETER)
        print(f"{'problem':<19}{'order':<12}{'seen':>6}{sizes}   (median, 90 %: percent more loss)")
        with single_thread(), np.errstate(all="ignore"):
            for name in arguments.problems.split(","):
                problem = (
                    synthetic(name)
                    if name in SYNTHETIC
                    else build_problem(composed([f"problem={name}"]))
                )
                best = optimum(name, problem)
                for kind in ORDERS:
                    full, losses = figures(name, problem, best, kind, arguments.orders)
                    middle, high = np.quantile(losses, [0.5, 0.9], axis=0)
                    cells = "".join(
                        f"{a:>11.3g}{b:>11.3g}" for a, b in zip(middle, high, strict=True)
                    )
                    print(f"{name:<19}{kind:<12}{np.mean(full):>6.2f}{cells}", flush=True)

    run_and_exit(job)


if __name__ == "__main__":
    main()
