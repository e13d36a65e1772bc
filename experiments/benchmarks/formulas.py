"""Cost of a row of a formula, value and all derivatives, on the machine and in NumPy.

python -m experiments.benchmarks.formulas [--quick] [--output FOLDER]

The tire, the 27 coefficients of MF 6.1's lateral force, and the published formulas, at 3,000 rows.
The machine runs on each level of instructions that the processor has: one tape of value and
derivatives as in `miho.fit_many`, or two tapes as in the steps of `miho.fit`, which needs
derivatives less often. NumPy evaluates the formula as written, once for values and once for
derivatives. "ready" is the cost of a new formula before its first evaluation: tracing of value and
derivatives, and compilation of both tapes.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from time import perf_counter
from typing import Any, cast

import numpy as np
import pandas as pd

from baselines.problems.published_model import FORMS, PublishedModel
from experiments.benchmarks.bars import Measured, at_least, at_most, benchmark, interleaved, shown
from miho.core import Tape, machine
from miho.models.expression import Expression
from miho.models.formula_tape import traced_tapes, traced_together
from miho.quantities import Array
from miho.vehicle.data import embedded_tire
from miho.vehicle.models import Pacejka, TireFormula, load_tir
from miho.vehicle.models.lateral_magic_formula import COEFFICIENTS

ROWS = 3000
REPEATS, ATOM = 40, 1e-3
"""Turns of each job, and seconds of a turn: less than a time slice of a busy processor."""
MAGIC, PUBLISHED = "MF 6.1 lateral", "published"
NEW_FORMULA, NEW_MAGIC_FORMULA = 10, 30
"""Largest time [ms] for a new formula."""
TIRE, TIRE_COST = "tire", {"avx2": 9.0, "avx512": 6.5}
"""Largest cost of a row [ns] by level, with one tape."""


@dataclass(frozen=True)
class Case:
    """A formula with a range of its inputs and a range of its parameters."""

    name: str
    model: Expression
    inputs: tuple[tuple[float, float], ...]
    thetas: tuple[tuple[float, float], ...]

    @property
    def at(self) -> tuple[Array, Array]:
        """Columns (p, ROWS) and parameters (d,)."""
        rng = np.random.default_rng(0)
        X = np.array([rng.uniform(low, high, ROWS) for low, high in self.inputs])
        return X, np.array([rng.uniform(low, high) for low, high in self.thetas])

    @cached_property
    def tapes(self) -> tuple[Tape, Tape]:
        """Value and derivatives."""
        return cast(tuple[Tape, Tape], self.model.tapes)

    @cached_property
    def together(self) -> Tape:
        """Derivatives and value on one tape."""
        model = self.model
        p, d = len(model.inputs), len(model.parameters)
        return cast(Tape, traced_together(model.value, model.derivatives, p, d))


def cases() -> Iterator[Case]:
    """All formulas."""
    tire = (2.0, 20.0), (1.0, 2.0), (2e3, 5e3), (-0.02, 0.02), (-100.0, 100.0)
    yield Case(TIRE, Pacejka(), ((-0.25, 0.25),), tire)
    base = load_tir(embedded_tire("lf"))
    magic = TireFormula(base, tuple(COEFFICIENTS), "Fy", ("alpha", "Fz", "gamma", "pressure"))
    inputs = (-0.2, 0.2), (1e3, 6e3), (-0.05, 0.05), (1.5e5, 2.5e5)
    values = [float(getattr(base.parameters, name)) for name in COEFFICIENTS]
    yield Case(MAGIC, magic, inputs, tuple((v - 0.01, v + 0.01) for v in values))
    for name in FORMS:
        model = PublishedModel(name)
        yield Case(
            f"{PUBLISHED}: {name}", model, ((0.1, 2.0),) * len(model.inputs),
            ((0.2, 2.0),) * len(model.parameters),
        )  # fmt: skip


def two_tapes(level: str) -> str:
    """Column of a level with two tapes."""
    return f"{level}, two tapes"


def both(call: Callable[[Any, Array, Array, Array], None], tapes: Any, *arrays: Array) -> None:
    """Evaluate value and derivatives on the machine."""
    theta, X, value, slopes = arrays
    call(tapes[0], theta, X, value)
    call(tapes[1], theta, X, slopes)


def by_numpy(model: Expression, theta: Array, X: Array) -> None:
    """Evaluate value and derivatives in NumPy as written."""
    model.predict(theta[None], *X)
    model.jacobian(theta, *X)


def measured(case: Case, repeats: int) -> dict[str, Any]:
    """One row of the table."""
    X, theta = case.at
    d, p = theta.size, len(X)
    started = perf_counter()
    traced_tapes(case.model.value, case.model.derivatives, p, d)
    row: dict[str, Any] = {"formula": case.name}
    row["ready [ms]"] = 1e3 * (perf_counter() - started)
    row["instructions"] = sum(len(tape.code) for tape in case.tapes)
    jobs: dict[str, Callable[[], object]] = {"NumPy": partial(by_numpy, case.model, theta, X)}
    out = np.empty((1, 1, ROWS)), np.empty((1, d, ROWS))
    everything = np.empty((1, d + 1, ROWS))
    for level, name in enumerate(machine().levels()):
        together, separate = case.together.at_level(level), [t.at_level(level) for t in case.tapes]
        jobs[name] = partial(machine().evaluate, together, theta[None], X, everything)
        jobs[two_tapes(name)] = partial(both, machine().evaluate, separate, theta[None], X, *out)
    seconds = interleaved(jobs, repeats, ATOM)
    return row | {name: 1e9 * value / ROWS for name, value in seconds.items()}


def measure(quick: bool) -> Measured:
    """All formulas."""
    if machine() is None:
        raise ValueError("the machine of miho.core was not built; install with a C compiler")
    repeats, levels = (10 if quick else REPEATS), machine().levels()
    chosen = list(cases())[: 6 if quick else None]
    table = pd.DataFrame([*shown(measured(case, repeats) for case in chosen)])
    gain = table["NumPy"] / table[two_tapes(levels[-1])]
    published = gain[table["formula"].str.startswith(PUBLISHED)]
    magic = table["formula"] == MAGIC
    tire = table[table["formula"] == TIRE]
    bars = [
        *(at_most(f"{TIRE} by {level}, a row", tire[level].min(), most, "ns")
          for level, most in TIRE_COST.items() if level in levels),
        at_least(f"published formulas by {two_tapes(levels[-1])}, over NumPy, median",
            published.median(), 1, "times"),
        at_most("a new formula", table.loc[~magic, "ready [ms]"].median(), NEW_FORMULA, "ms"),
        at_most(f"a new {MAGIC}", table.loc[magic, "ready [ms]"].min(), NEW_MAGIC_FORMULA,
            "ms"),
    ]  # fmt: skip
    notes = [f"ns a row; published formulas: least gain over NumPy {published.min():.2f}"]
    return Measured(table, table, [b for b in bars if b.measured == b.measured], notes)


if __name__ == "__main__":
    benchmark(__doc__, measure, "formulas")
