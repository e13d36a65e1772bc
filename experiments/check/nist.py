"""Correct digits of parameters and standard errors on NIST's 27 problems, with SciPy and lmfit.

python -m experiments.check.nist [--seed 0]   # a minute; columns of lmfit if it is installed

The certified values are from NIST's Statistical Reference Datasets for nonlinear regression, with
eleven digits. The default method gets a box instead of a starting point: from a tenth of the
smaller published starting value of a parameter to ten times the larger one, on a logarithmic scale.
If a starting value is negative, the box is linear, up to ten times the larger magnitude on both
sides of zero. The other solvers get the two published starting points and no box.
"""

import importlib
import importlib.util
import itertools
import math
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd
import scipy.optimize
from tqdm import tqdm

from baselines.problems import PublishedFit, PublishedModel, published_fit, published_names
from experiments.check import arguments
from miho.identification import CurveFit, make_report
from miho.optim import MIHOGN, Parameter, Space, minimize
from miho.quantities import Array

Estimate = tuple[Array, Array]
"""Parameters (d,) and their standard errors (d,)."""

BEYOND = 10.0
"""Factor from the published starting values to the ends of the box."""
MOST = 11
"""Number of certified digits."""
FOUND, DIGITS, ERROR_DIGITS = 2, 6, 4
"""Correct digits of all parameters at which the optimum is found, and at which the problem is
solved; and correct digits of all standard errors."""
ALIKE: Mapping[str, tuple[tuple[int, ...], ...]] = {
    "three_decays": ((0, 1), (2, 3), (4, 5)),
    "two_peaks": ((2, 3, 4), (5, 6, 7)),
    "enso": ((3, 4, 5), (6, 7, 8)),
    "osborne_1": ((1, 3), (2, 4)),
}
"""Interchangeable terms of a formula, by the positions of their parameters."""


def nist_names() -> list[str]:
    """The names of NIST's problems."""
    return [name for name in published_names() if published_fit(name).collection == "nist"]


def boxed(fit: PublishedFit) -> CurveFit:
    """Problem in the box from its published starting values."""
    model = PublishedModel(fit.model)
    parameters = []
    for name, starts in zip(model.parameters, zip(*fit.starts, strict=True), strict=True):
        low, high = min(starts), max(starts)
        if low > 0:
            parameters.append(Parameter(name, "-", low / BEYOND, high * BEYOND, scale="log"))
        else:
            reach = BEYOND * max(map(abs, starts))
            parameters.append(Parameter(name, "-", -reach, reach))
    return CurveFit(model, fit.dataset, Space(tuple(parameters)))


def digits(estimate: Array, certified: Array) -> float:
    """Correct digits of the worst value, 0 to MOST."""
    error = np.max(np.abs(estimate - certified) / np.abs(certified))
    if not math.isfinite(error):
        return 0.0
    return float(np.clip(-math.log10(max(error, 10.0**-MOST)), 0, MOST))


def judged(fit: PublishedFit, estimate: Estimate) -> tuple[float, float]:
    """Correct digits of parameters and of standard errors, in the best order of terms."""
    theta, errors = estimate
    terms = ALIKE.get(fit.model, ())
    scores = []
    for places in itertools.permutations(terms):
        order = np.arange(theta.size)
        order[list(itertools.chain(*terms))] = list(itertools.chain(*places))
        scores.append(
            (
                digits(theta[order], np.array(fit.optimum)),
                digits(errors[order], np.array(fit.standard_errors)),
            )
        )
    return max(scores)


def by_miho(fit: PublishedFit, seed: int) -> Estimate:
    """Estimate by the default method in the box, with standard errors for independent rows."""
    problem = boxed(fit)
    record = minimize(MIHOGN(), problem, seed=seed)
    if record.theta is None:
        return np.full(len(problem.space), np.nan), np.full(len(problem.space), np.nan)
    at = make_report(problem, record.theta, descents=record.descents, profiles=False).at
    return at.theta, at.independent.standard_errors


def by_curve_fit(fit: PublishedFit, start: Array) -> Estimate:
    """`scipy.optimize.curve_fit` with its defaults: MINPACK's Levenberg-Marquardt, differences."""
    curve = _curve(fit)

    def values(_: Array, *theta: float) -> Array:
        return curve(np.array(theta))

    rows = np.arange(len(fit.dataset))
    theta, covariance = scipy.optimize.curve_fit(values, rows, fit.dataset["y"], start)
    return theta, np.sqrt(np.diag(covariance))


def by_least_squares(fit: PublishedFit, start: Array) -> Estimate:
    """`scipy.optimize.least_squares` with its defaults: trust region, differences."""
    curve = _curve(fit)

    def residuals(theta: Array) -> Array:
        return curve(theta) - fit.dataset["y"]

    solution = scipy.optimize.least_squares(residuals, start)
    freedom = len(fit.dataset) - start.size
    J = np.asarray(solution.jac)
    inverse = np.linalg.inv(J.T @ J)
    return solution.x, np.sqrt(np.diag(inverse) * 2 * solution.cost / freedom)


def by_lmfit(fit: PublishedFit, start: Array) -> Estimate:
    """`lmfit.minimize` with its defaults."""
    lmfit = importlib.import_module("lmfit")
    curve, parameters = _curve(fit), lmfit.Parameters()
    names = [f"b{k + 1}" for k in range(start.size)]
    for name, value in zip(names, start, strict=True):
        parameters.add(name, value=value)

    def residuals(values: Any) -> Array:
        return curve(np.array([values[name].value for name in names])) - fit.dataset["y"]

    solved = lmfit.minimize(residuals, parameters).params
    errors = [solved[name].stderr for name in names]
    return (
        np.array([solved[name].value for name in names]),
        np.array([math.nan if error is None else error for error in errors]),
    )


def _curve(fit: PublishedFit) -> Callable[[Array], Array]:
    """The model on the rows of the data as a function of its parameters (d,)."""
    model = PublishedModel(fit.model)
    inputs = [fit.dataset[name] for name in model.inputs]
    return lambda theta: model.predict(theta[None], *inputs)[0]


def table(names: list[str], seed: int = 0) -> pd.DataFrame:
    """One row per problem; "6.1 / 4.2" are digits of parameters and of standard errors."""
    rivals = {"curve_fit": by_curve_fit, "least_squares": by_least_squares}
    if importlib.util.find_spec("lmfit"):
        rivals["lmfit"] = by_lmfit
    rows = []
    for name in tqdm(names, desc="problems", disable=None):
        fit = published_fit(name)
        row: dict[str, object] = {"problem": name, "miho": judged(fit, by_miho(fit, seed))}
        for rival, solve in rivals.items():
            for number, start in enumerate(fit.starts, start=1):
                row[f"{rival} {number}"] = _attempt(fit, solve, np.array(start))
        rows.append(row)
    return pd.DataFrame(rows)


def _attempt(
    fit: PublishedFit, solve: Callable[[PublishedFit, Array], Estimate], start: Array
) -> tuple[float, float]:
    """Digits that a solver reaches; (0, 0) if it fails."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            return judged(fit, solve(fit, start))
        except (RuntimeError, ValueError, TypeError, np.linalg.LinAlgError):
            return 0.0, 0.0


def main() -> None:
    """Print the digits, and the number of problems with enough digits."""
    results = table(nist_names(), arguments(__doc__, seed=0).seed)
    columns = [name for name in results.columns if name != "problem"]
    print(
        "Right digits of all parameters / of all standard errors, against NIST's certified values"
    )
    print(
        "(11 at most). miho: from a box; the others: from published start 1 (far) and 2 (near).\n"
    )
    shown = results.copy()
    for name in columns:
        shown[name] = [f"{theta:.1f} / {error:.1f}" for theta, error in results[name]]
    print(f"{shown.to_string(index=False)}\n\n{summary(results).to_string(index=False)}")


def summary(results: pd.DataFrame) -> pd.DataFrame:
    """Number of problems with enough digits, one row per criterion."""
    criteria: Mapping[str, Callable[[float, float], bool]] = {
        f"{FOUND} digits of all parameters": lambda theta, _: theta >= FOUND,
        f"{DIGITS} digits of all parameters": lambda theta, _: theta >= DIGITS,
        f"and {ERROR_DIGITS} of all standard errors": lambda theta, error: (
            theta >= DIGITS and error >= ERROR_DIGITS
        ),
    }
    columns = [name for name in results.columns if name != "problem"]
    return pd.DataFrame(
        {"problems with": key}
        | {name: sum(enough(*score) for score in results[name]) for name in columns}
        for key, enough in criteria.items()
    )


if __name__ == "__main__":
    main()
