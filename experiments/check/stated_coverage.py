"""Coverage of 95 % intervals for problems with ties, priors, sigma or several parts.

python -m experiments.check.stated_coverage [--sets 500]   # some minutes

Each dataset is a decay of 40 rows with normal noise. `tied`: two terms, with the second rate tied
to the first and a gap, and one amplitude fixed. `ordered`: the same with the order as a constraint.
`sigma`: half of the rows have ten times the noise, as stated. `prior`: a rate with a log-normal
prior, from which the truth of each dataset is drawn, with stated or estimated noise. `two sets`:
two datasets share the rate, with different amplitudes and unequal noise, stated or estimated.
`two sets` is searched by `fit_joint`, the other cases by a descent from the truth.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

import miho
from experiments.check import arguments
from experiments.check.coverage import HEAD, share_text
from experiments.check.uneven_spread import decay
from miho import Fit, Part
from miho.optim.seeds import stream
from miho.quantities import Array

T = np.linspace(0, 2, 40)
NOISE = 0.05
Truth = dict[str, float]


def two(t: Array, a: float, b: float, c: float, d: float) -> Array:
    """Two of them."""
    return decay(t, a, b) + decay(t, c, d)


def tied(rng: np.random.Generator) -> tuple[Fit, Truth]:
    """A rate tied to another and a gap, and an amplitude fixed."""
    truth = {"a": 1.0, "b": 0.7, "d": 3.7, "gap": 3.0}
    y = two(T, 1.0, 0.7, 2.0, 3.7) + NOISE * rng.standard_normal(T.size)
    start = {name: truth[name] for name in ("a", "b", "gap")}
    bounds = {"a": (0, 5), "b": (0, 5), "gap": (0, 20)}
    fit = miho.fit(two, T, y, bounds, start=start, fixed={"c": 2.0}, tied={"d": "b + gap"})
    return fit, truth


def ordered(rng: np.random.Generator) -> tuple[Fit, Truth]:
    """Two rates, the second larger than the first."""
    truth = {"a": 1.0, "b": 0.7, "d": 3.7}
    y = two(T, 1.0, 0.7, 2.0, 3.7) + NOISE * rng.standard_normal(T.size)
    bounds = {"a": (0, 5), "b": (0, 20), "d": (0, 20)}
    return miho.fit(two, T, y, bounds, start=truth, fixed={"c": 2.0}, constraints="b < d"), truth


def sigma(rng: np.random.Generator) -> tuple[Fit, Truth]:
    """Rows of unequal, stated noise."""
    truth = {"a": 2.0, "b": 1.5}
    deviation = np.where(np.arange(T.size) % 2, NOISE, 10 * NOISE)
    y = decay(T, **truth) + deviation * rng.standard_normal(T.size)
    return miho.fit(decay, T, y, {"a": (0, 9), "b": (0, 9)}, sigma=deviation, start=truth), truth


def prior(rng: np.random.Generator, stated: bool) -> tuple[Fit, Truth]:
    """A rate that is drawn from its prior."""
    truth = {"a": 2.0, "b": 1.5 * float(np.exp(0.15 * rng.standard_normal()))}
    y = decay(T, **truth) + 4 * NOISE * rng.standard_normal(T.size)
    rate = {"low": 0.01, "high": 50, "scale": "log", "prior": (1.5, 0.15)}
    noise = 4 * NOISE if stated else None
    return miho.fit(decay, T, y, {"a": (0, 9), "b": rate}, sigma=noise, start=truth), truth


def joint(rng: np.random.Generator, stated: bool) -> tuple[Fit, Truth]:
    """Two sets that share a rate."""
    truth = {"a_left": 2.0, "a_right": 3.0, "b": 1.5}
    parts = {}
    for name, rows, deviation in (("left", T, NOISE), ("right", T[::2], 4 * NOISE)):
        y = decay(rows, truth[f"a_{name}"], 1.5) + deviation * rng.standard_normal(rows.size)
        parts[name] = Part(decay, rows, y, deviation if stated else None)
    return miho.fit_joint(parts, {"a": (0, 9), "b": (0, 9)}, local=["a"]), truth


CASES: dict[str, Callable[[np.random.Generator], tuple[Fit, Truth]]] = {
    "tied": tied,
    "ordered": ordered,
    "sigma": sigma,
    "prior": lambda rng: prior(rng, stated=True),
    "prior, sigma estimated": lambda rng: prior(rng, stated=False),
    "two sets, sigma stated": lambda rng: joint(rng, stated=True),
    "two sets, sigma estimated": lambda rng: joint(rng, stated=False),
}


def coverage(case: str, sets: int) -> list[dict[str, Any]]:
    """A row for each parameter."""
    hits: dict[tuple[str, str], list[bool]] = {}
    for number in tqdm(range(sets), desc=case, disable=None):
        fit, truth = CASES[case](stream("stated", case, number))
        table = fit.parameters
        report = fit.report(profiles=True)
        profiles = dict(zip(report.space.names, report.profiles, strict=True))
        profiles |= report.tied_profiles
        for name, value in truth.items():
            low, high = map(float, table.loc[name, ["low", "high"]])
            hits.setdefault((name, "linearised"), []).append(low <= value <= high)
            curve = profiles.get(name)
            if curve is not None:
                hits.setdefault((name, "profile"), []).append(curve.low <= value <= curve.high)
    rows: dict[str, dict[str, Any]] = {}
    for (name, kind), inside in hits.items():
        row = rows.setdefault(name, {"case": case, "parameter": name})
        row[kind] = share_text(sum(inside), len(inside))
    return list(rows.values())


def main() -> None:
    """Print a row for each parameter of each case."""
    sets = arguments(__doc__, sets=500).sets
    rows = [row for case in CASES for row in coverage(case, sets)]
    print(HEAD)
    print(pd.DataFrame(rows).fillna("-").to_string(index=False))


if __name__ == "__main__":
    main()
