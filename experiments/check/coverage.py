"""How often the 95 % intervals hold the truth, on synthetic tire data.

python -m experiments.check.coverage [--bootstrapped 500]   # with it half an hour

Each data set has 300 slip angles, uniform within 0.3 rad, the force of Eq. 4 and normal noise:
size, parameters and noise of the authors' sample data, tire A. Intervals are linearised and by
profile likelihood on all sets, by bootstrap on the first ones.
"""

from __future__ import annotations

import argparse

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import binomtest
from tqdm import tqdm

from miho.data import Dataset
from miho.identification import CurveFit, linearised
from miho.identification.bootstrap import bootstrap, percentile_intervals
from miho.identification.profile_likelihood import likelihood_profile
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


def synthetic(number: int) -> CurveFit:
    """The fit to one synthetic data set."""
    rng = stream("coverage", number)
    alpha = rng.uniform(-0.3, 0.3, ROWS)
    force = Pacejka().predict(TRUTH[None], alpha)[0] + NOISE * rng.standard_normal(ROWS)
    units = {"alpha": "rad", "Fy": "N"}
    data = Dataset(f"synthetic_{number}", {"alpha": alpha, "Fy": force}, units, "Fy")
    return CurveFit(Pacejka(), data, SPACE)


def intervals(problem: CurveFit, replicates: int) -> dict[str, Array]:
    """Intervals (5, 2) of each kind; the search starts at the truth, as a global one would end."""
    at = linearised(problem, refit(problem, TRUTH).theta)
    profiles = [likelihood_profile(problem, at, i) for i in range(TRUTH.size)]
    by_kind = {
        "linearised": at.intervals(),
        "profile": np.array([(p.low, p.high) for p in profiles]),
    }
    if replicates:
        rng = stream("bootstrap", problem.dataset.digest)
        thetas = bootstrap(problem, at.theta, replicates, rng)
        by_kind["bootstrap"] = percentile_intervals(thetas, ROWS, at.freedom)
    return by_kind


def coverage(sets: int, bootstrapped: int, replicates: int) -> pd.DataFrame:
    """Share of sets whose interval holds the truth, a row per kind and number of sets."""
    hits: dict[str, list[NDArray[np.bool_]]] = {}
    for number in tqdm(range(sets), desc="data sets", disable=None):
        problem = synthetic(number)
        for kind, ends in intervals(problem, replicates * (number < bootstrapped)).items():
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
    arguments = parser.parse_args()
    table = coverage(arguments.sets, arguments.bootstrapped, arguments.replicates)
    print("Share of data sets whose nominal 95 % interval holds the truth, with the interval of")
    print("that share for so many sets (Clopper and Pearson):\n")
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
