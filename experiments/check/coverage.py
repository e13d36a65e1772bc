"""Coverage of 95 % intervals on synthetic tire data.

python -m experiments.check.coverage [--bootstrapped 500]   # with bootstrap half an hour
python -m experiments.check.coverage --correlation 0.8 [--bootstrapped 500]
python -m experiments.check.coverage --noises [--sets 200]  # linear models, other dependence
python -m experiments.check.coverage --curvature 1.4 0.0 [--bootstrapped 500] [--replicates 200]

Each dataset has 300 slip angles, uniform within 0.3 rad, the force of Eq. 4 and normal noise, with
the size, parameters and noise of the authors' sample data of tire A. Linearised intervals and
profile likelihood are computed on all datasets, the bootstrap on the first ones.

With a correlation, the rows are in the order of a drive: the slip angle swings one and a half times
through its range, and the noise is autoregressive of first order with a third of the size. The
intervals are then the intervals of a report, which treats rows as dependent if it finds that
neighbours are correlated. The first rows of the table treat the rows as independent.

`--noises` uses linear models, whose estimates need no search, on several kinds of noise. The table
has the lowest and the highest coverage of the parameters, for rows taken as independent and as in a
report, and the ratio of the interval widths (medians). The columns of the models are a quadratic
drift, and the derivatives of the tire's force over that drive (swing) and at random slip angles.

`--curvature C E` uses the Magic Formula with curvature E, for which several optima fit within the
noise: 161 slip angles, evenly spaced within 0.8 rad, B = 5.385, D = 1, and noise of 2 % of D.
`miho.fit` searches each dataset without a starting point and prints linearised intervals. The
report's intervals are about its optimum, which may be better. "alone" are the intervals of the best
optimum without the other optima. The last line gives how often the report names several optima.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.stats import binomtest
from tqdm import tqdm

import miho
from miho import Dataset, Parameter, Space
from miho.identification import CurveFit, Report, linearised, make_report
from miho.identification.refit import refit
from miho.models import Model
from miho.optim.seeds import stream
from miho.quantities import Array
from miho.vehicle.models import Pacejka

TRUTH = np.array([17.35, 1.665, 2655.7, -0.0074, 116.4])
NOISE = 391.33
ROWS = 300
FEW = 100
SETTLING = 500
"""Number of noise values before the first row, so that the noise is stationary."""
NOISES: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "white": ((1.0,), (1.0,)),
    "AR(1) 0.3": ((1.0, -0.3), (1.0,)),
    "AR(1) 0.8": ((1.0, -0.8), (1.0,)),
    "AR(1) 0.95": ((1.0, -0.95), (1.0,)),
    "AR(2) 1.3, -0.6": ((1.0, -1.3, 0.6), (1.0,)),
    "AR(2) 0.5, 0.35": ((1.0, -0.5, -0.35), (1.0,)),
    "MA(5) equal": ((1.0,), (1.0,) * 6),
}
"""Denominator and numerator of each noise, as in `scipy.signal.lfilter`."""
SLIP = np.linspace(-0.8, 0.8, 161)
STIFFNESS, LITTLE = 5.385, 0.02
CURVED = {"B": (1, 30), "C": (0.5, 3), "D": (0.1, 3), "E": (-10, 1)}
"""Box of the curve with curvature; a tire has E up to 1."""
HEAD = """\
Share of data sets whose nominal 95 % interval holds the truth, with the interval of
that share for so many sets (Clopper and Pearson):
"""
DESIGNS = ("drift", "swing", "random")
LENGTHS = (60, 300, 3000)
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
    """Fit to a synthetic dataset; with a correlation, to a dataset of a drive."""
    rng = stream("coverage", number)
    if correlation:
        alpha = 0.3 * np.sin(3 * np.pi * np.arange(ROWS) / ROWS)
        noise = NOISE / 3 * autoregressive(correlation, ROWS, rng)
    else:
        alpha = rng.uniform(-0.3, 0.3, ROWS)
        noise = NOISE * rng.standard_normal(ROWS)
    return tire_fit(f"synthetic_{number}", alpha, noise)


def tire_fit(name: str, alpha: Array, noise: Array) -> CurveFit:
    """Fit to forces of the tire at slip angles (N,) [rad], with noise (N,) [N]."""
    force = Pacejka().predict(TRUTH[None], alpha)[0] + noise
    data = Dataset(name, {"alpha": alpha, "Fy": force}, {"alpha": "rad", "Fy": "N"}, "Fy")
    return CurveFit(Pacejka(), data, SPACE)


def autoregressive(correlation: float, rows: int, rng: np.random.Generator) -> Array:
    """Stationary normal noise (rows,) of variance 1 with this correlation between neighbours."""
    innovations = np.sqrt(1 - correlation**2) * rng.standard_normal(rows)
    innovations[0] /= np.sqrt(1 - correlation**2)
    return np.asarray(lfilter([1.0], [1.0, -correlation], innovations))


def intervals(problem: CurveFit, replicates: int, dependent: bool) -> dict[str, Array]:
    """Intervals (5, 2) of each kind; the search starts at the truth instead of a global search."""
    report = make_report(problem, refit(problem, TRUTH).theta, replicates=replicates, profiles=True)
    by_kind = {"for independent rows": report.at.independent.intervals()} if dependent else {}
    for kind in ("linearised", "profile", "bootstrap"):
        if f"{kind} low" in report.parameters:
            by_kind[kind] = report.parameters[[f"{kind} low", f"{kind} high"]].to_numpy()
    return by_kind


@dataclass(frozen=True)
class LinearModel(Model):
    """The sum of the inputs, each times a parameter."""

    columns: int

    @property
    def inputs(self) -> dict[str, str]:
        """x0, x1, ..."""
        return {f"x{k}": "-" for k in range(self.columns)}

    @property
    def parameters(self) -> dict[str, str]:
        """b0, b1, ..."""
        return {f"b{k}": "-" for k in range(self.columns)}

    output = "-"

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Sums (n, N)."""
        return np.asarray(thetas @ np.array(inputs))

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """The inputs, (N, d)."""
        return np.array(inputs).T


def design(kind: str, rows: int, rng: np.random.Generator) -> Array:
    """Columns (rows, d), each of unit size."""
    along = np.arange(rows) / rows
    if kind == "drift":
        X = np.stack([np.ones(rows), along, along**2], axis=1)
    else:
        swing = 0.3 * np.sin(3 * np.pi * along)
        alpha = swing if kind == "swing" else rng.uniform(-0.3, 0.3, rows)
        X = Pacejka().jacobian(TRUTH, alpha)
    return np.asarray(X / np.linalg.norm(X, axis=0))


def linear_fit(X: Array, noise: Array) -> tuple[CurveFit, Array]:
    """Fit of columns (N, d) to noise (N,), with true parameters 0, and its optimum."""
    model = LinearModel(X.shape[1])
    columns = {**dict(zip(model.inputs, X.T, strict=True)), "y": noise}
    data = Dataset("linear", columns, dict.fromkeys(columns, "-"), "y")
    space = Space(tuple(Parameter(name, "-", -1e6, 1e6) for name in model.parameters))
    return CurveFit(model, data, space), np.asarray(np.linalg.lstsq(X, noise, rcond=None)[0], float)


def curved(C: float, E: float, number: int, replicates: int) -> tuple[dict[str, Array], bool]:
    """Intervals (4, 2) of each kind for a curve with curvature; whether it has several optima."""
    rng = stream("coverage", "curvature", number)
    force = magic_formula(SLIP, STIFFNESS, C, 1.0, E) + LITTLE * rng.standard_normal(SLIP.size)
    fit = miho.fit(magic_formula, SLIP, force, CURVED, seed=number)
    report = fit.report(replicates=replicates, profiles=True)
    alone = fit.report(descents=None, profiles=True)
    by_kind = {f"{kind}, alone": ends_of(alone, kind) for kind in ("linearised", "profile")}
    by_kind["printed by fit"] = fit.parameters[["low", "high"]].to_numpy()
    kinds = ["linearised", "profile"] + ["bootstrap"] * (replicates > 0)
    return by_kind | {kind: ends_of(report, kind) for kind in kinds}, len(report.optima) > 0


def ends_of(report: Report, kind: str) -> Array:
    """Ends (d, 2) of the intervals of a kind in a report."""
    return report.parameters[[f"{kind} low", f"{kind} high"]].to_numpy()


def magic_formula(x: Array, B: float, C: float, D: float, E: float) -> Array:
    """The Magic Formula with curvature."""
    return D * np.sin(C * np.arctan(B * x - E * (B * x - np.arctan(B * x))))


def curvature(C: float, E: float, sets: int, bootstrapped: int, replicates: int) -> str:
    """Table of the coverage for the curve with curvature, and how often it has several optima."""
    truth, several = np.array([STIFFNESS, C, 1.0, E]), 0
    hits: dict[str, list[NDArray[np.bool_]]] = {}
    for number in tqdm(range(sets), desc="data sets", disable=None):
        by_kind, many = curved(C, E, number, replicates * (number < bootstrapped))
        several += many
        for kind, ends in by_kind.items():
            hits.setdefault(kind, []).append((ends[:, 0] <= truth) & (truth <= ends[:, 1]))
    table = shares(hits, list(CURVED), [sets]).to_string(index=False)
    return f"{table}\n\nseveral optima in {several} of {sets} sets"


def held(name: str, kind: str, rows: int, sets: int) -> dict[str, object]:
    """A row of the table of noises."""
    poles, zeros = NOISES[name]
    independent, reported, wider = [], [], []
    for number in range(sets):
        rng = stream("coverage", name, kind, rows, number)
        noise = lfilter(zeros, poles, rng.standard_normal(rows + SETTLING))[SETTLING:]
        problem, theta = linear_fit(design(kind, rows, rng), noise)
        at = linearised(problem, theta, neighbours=True)
        reach = at.intervals()[:, 1] - theta
        plain = at.independent.intervals()[:, 1] - theta
        independent.append(np.abs(theta) <= plain)
        reported.append(np.abs(theta) <= reach)
        wider.append(reach / plain)
    row: dict[str, object] = {"noise": name, "columns": kind, "rows": rows}
    for label, hits in (("independent", independent), ("report", reported)):
        shares = 100 * np.mean(hits, axis=0)
        row[label] = f"{shares.min():.1f} to {shares.max():.1f} %"
    factors = np.median(wider, axis=0)
    return {**row, "wider": f"{factors.min():.1f} to {factors.max():.1f}"}


def noises(sets: int) -> pd.DataFrame:
    """Coverage of linear models on each kind of noise, as described in the module docstring."""
    cases = [(name, kind, rows) for name in NOISES for kind in DESIGNS for rows in LENGTHS]
    return pd.DataFrame([held(*case, sets) for case in tqdm(cases, disable=None)])


def coverage(
    sets: int, bootstrapped: int, replicates: int, correlation: float = 0.0
) -> pd.DataFrame:
    """Share of datasets whose interval contains the truth, one row per kind and number of sets."""
    hits: dict[str, list[NDArray[np.bool_]]] = {}
    for number in tqdm(range(sets), desc="data sets", disable=None):
        problem = synthetic(number, correlation)
        drawn = replicates * (number < bootstrapped)
        for kind, ends in intervals(problem, drawn, correlation > 0).items():
            hits.setdefault(kind, []).append((ends[:, 0] <= TRUTH) & (ends[:, 1] >= TRUTH))
    return shares(hits, SPACE.names, [FEW, sets])


def shares(
    hits: Mapping[str, Sequence[NDArray[np.bool_]]], names: Sequence[str], sizes: Sequence[int]
) -> pd.DataFrame:
    """Coverage of each parameter, for each kind in its first datasets."""
    rows = []
    for kind, held in hits.items():
        for n in sorted({min(size, len(held)) for size in sizes}):
            count = np.sum(held[:n], axis=0)
            row: dict[str, object] = {"interval": kind, "sets": n}
            for name, k in zip(names, count, strict=True):
                row[name] = share_text(k, n)
            rows.append(row)
    return pd.DataFrame(rows)


def share_text(k: int, n: int) -> str:
    """Text of the share k of n, with its 95 % interval."""
    share = binomtest(int(k), n).proportion_ci()
    return f"{100 * k / n:.1f} % [{100 * share.low:.0f}, {100 * share.high:.0f}]"


def main() -> None:
    """Print the coverage of each parameter with a 95 % interval."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--sets", type=int, default=500)
    parser.add_argument("--bootstrapped", type=int, default=100)
    parser.add_argument("--replicates", type=int, default=1000)
    parser.add_argument("--correlation", type=float, default=0.0)
    parser.add_argument("--noises", action="store_true")
    parser.add_argument("--curvature", type=float, nargs=2, metavar=("C", "E"))
    arguments = parser.parse_args()
    if arguments.curvature is not None:
        C, E = arguments.curvature
        print(curvature(C, E, arguments.sets, arguments.bootstrapped, arguments.replicates))
        return
    if arguments.noises:
        print(noises(arguments.sets).to_string(index=False))
        return
    if not 0 <= arguments.correlation < 1:
        parser.error(f"--correlation is {arguments.correlation:g}; expected from 0 to below 1")
    table = coverage(
        arguments.sets, arguments.bootstrapped, arguments.replicates, arguments.correlation
    )
    print(HEAD)
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
