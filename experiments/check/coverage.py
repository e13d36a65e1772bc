"""How often the 95 % intervals hold the truth, on synthetic tire data.

python -m experiments.check.coverage [--bootstrapped 500]   # with it half an hour
python -m experiments.check.coverage --correlation 0.8

Each data set has 300 slip angles, uniform within 0.3 rad, the force of Eq. 4 and normal noise:
size, parameters and noise of the authors' sample data, tire A. Intervals are linearised and by
profile likelihood on all sets, by bootstrap on the first ones.

With a correlation the rows are in the order of a drive: the slip angle swings one and a half times
through its range, and the noise is autoregressive, of the first order and a third of the size. The
intervals are then those that a report gives, which takes rows for dependent where it finds that
neighbours are alike; before them those that take them for independent.
"""

from __future__ import annotations

import argparse

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.stats import binomtest
from tqdm import tqdm

from miho.data import Dataset
from miho.identification import CurveFit, make_report
from miho.identification.refit import refit
from miho.models import Pacejka
from miho.optim import Parameter, Space
from miho.optim.seeds import stream

Array = NDArray[np.float64]

TRUTH = np.array([17.35, 1.665, 2655.7, -0.0074, 116.4])
NOISE = 391.33
ROWS = 300
FEW = 100
SPACE = Space(
    (
        Parameter("B", "1/rad", 2.0, 40.0),
        Parameter("C", "-", 1.0, 2.5),
        Parameter("D", "N", 1000.0, 5000.0),
        Parameter("Sx", "rad", -0.05, 0.05),
        Parameter("Sy", "N", -500.0, 500.0),
    )
)


def synthetic(number: int, correlation: float = 0.0) -> CurveFit:
    """The fit to one synthetic data set; with a correlation, to one of a drive."""
    rng = stream("coverage", number)
    if correlation:
        alpha = 0.3 * np.sin(3 * np.pi * np.arange(ROWS) / ROWS)
        noise = NOISE / 3 * autoregressive(correlation, ROWS, rng)
    else:
        alpha = rng.uniform(-0.3, 0.3, ROWS)
        noise = NOISE * rng.standard_normal(ROWS)
    force = Pacejka().predict(TRUTH[None], alpha)[0] + noise
    units = {"alpha": "rad", "Fy": "N"}
    data = Dataset(f"synthetic_{number}", {"alpha": alpha, "Fy": force}, units, "Fy")
    return CurveFit(Pacejka(), data, SPACE)


def autoregressive(correlation: float, rows: int, rng: np.random.Generator) -> Array:
    """Stationary normal noise (rows,) of variance 1 with this correlation between neighbours."""
    innovations = np.sqrt(1 - correlation**2) * rng.standard_normal(rows)
    innovations[0] /= np.sqrt(1 - correlation**2)
    return np.asarray(lfilter([1.0], [1.0, -correlation], innovations))


def intervals(problem: CurveFit, replicates: int, dependent: bool) -> dict[str, Array]:
    """Intervals (5, 2) of each kind; the search starts at the truth, as a global one would end."""
    report = make_report(problem, refit(problem, TRUTH).theta, replicates=replicates, profiles=True)
    by_kind = {"for independent rows": report.at.independent.intervals()} if dependent else {}
    for kind in ("linearised", "profile", "bootstrap"):
        if f"{kind} low" in report.parameters:
            by_kind[kind] = report.parameters[[f"{kind} low", f"{kind} high"]].to_numpy()
    return by_kind


def coverage(
    sets: int, bootstrapped: int, replicates: int, correlation: float = 0.0
) -> pd.DataFrame:
    """Share of sets whose interval holds the truth, a row per kind and number of sets."""
    hits: dict[str, list[NDArray[np.bool_]]] = {}
    for number in tqdm(range(sets), desc="data sets", disable=None):
        problem = synthetic(number, correlation)
        drawn = replicates * (number < bootstrapped)
        for kind, ends in intervals(problem, drawn, correlation > 0).items():
            hits.setdefault(kind, []).append((ends[:, 0] <= TRUTH) & (ends[:, 1] >= TRUTH))
    rows = []
    for kind, held in hits.items():
        for n in sorted({min(FEW, len(held)), len(held)}):
            count = np.sum(held[:n], axis=0)
            row: dict[str, object] = {"interval": kind, "sets": n}
            for name, k in zip(SPACE.names, count, strict=True):
                share = binomtest(int(k), n).proportion_ci()
                row[name] = f"{100 * k / n:.1f} % [{100 * share.low:.0f}, {100 * share.high:.0f}]"
            rows.append(row)
    return pd.DataFrame(rows)


def main() -> None:
    """Print the coverage of each parameter with its own 95 % interval."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--sets", type=int, default=500)
    parser.add_argument("--bootstrapped", type=int, default=100)
    parser.add_argument("--replicates", type=int, default=1000)
    parser.add_argument("--correlation", type=float, default=0.0)
    arguments = parser.parse_args()
    if not 0 <= arguments.correlation < 1:
        parser.error(f"--correlation is {arguments.correlation:g}; expected from 0 to below 1")
    table = coverage(
        arguments.sets, arguments.bootstrapped, arguments.replicates, arguments.correlation
    )
    print("Share of data sets whose nominal 95 % interval holds the truth, with the interval of")
    print("that share for so many sets (Clopper and Pearson):\n")
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
