"""Comparing models on the same data: information criteria, and F-tests of nested models.

Criteria assume normal errors. An unknown variance counts as a parameter (Burnham and Anderson,
Model Selection and Multimodel Inference, 2nd ed. 2002, Ch. 2 and 6.4), so the criteria agree with
`AIC` and `BIC` of R. The F-test follows Bates and Watts (Nonlinear Regression Analysis, 1988,
Ch. 3.10).
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
import scipy  # loads its subpackages at first use: importing them takes a second

from miho.identification.curve_fit import CurveFit
from miho.identification.flags import independence
from miho.identification.line_wrapping import wrapped
from miho.identification.refit import refit
from miho.identification.report import Report, Reporting, report_of, rounding_of
from miho.identification.residuals import Square
from miho.quantities import Array
from miho.units import differ

REPRODUCED = 1e-6
"""A model contains another if it follows the curve of the other up to this fraction of the sum of
squares of the errors."""
EVALUATIONS = 2000
LITTLE, NONE = 2.0, 10.0
"""A model has substantial support up to the first difference of AICc, and hardly any from the
second one (Burnham and Anderson 2002, p. 70)."""
SIGNIFICANT = 0.05


@dataclass(frozen=True, eq=False)
class ModelComparison:
    """A comparison of models that were fitted to the same rows; `compare_models` makes it.

    Parameters
    ----------
    reports : tuple of Report
        The reports of the fits. All tables and remarks are functions of them.
    """

    reports: tuple[Report, ...]

    @cached_property
    def table(self) -> pd.DataFrame:
        """A row per model, the smallest AICc first.

        Columns: model, free parameters, sum of squared errors, residual standard deviation (in the
        unit of the output), AIC, AICc, BIC, difference of AICc from the smallest, and Akaike
        weight: the probability that this model is the best of all for further data.
        """
        rows = []
        for report in self.reports:
            n, k = len(report.problem.dataset), free_parameters(report)
            K, squares = k + 1, n * report.error**2
            # -2 ln of the likelihood, in which the variance is a parameter unless sigma is known
            deviance = n * (math.log(2 * math.pi * squares / n) + 1)
            if report.at.noise_known:
                variance = report.at.noise**2
                K, deviance = k, n * math.log(2 * math.pi * variance) + squares / variance
            rows.append(
                {
                    "model": report.problem.name,
                    "parameters": k,
                    "squares": squares,
                    "deviation": math.sqrt(squares / (n - k)),
                    "AIC": deviance + 2 * K,
                    "AICc": deviance + 2 * K + 2 * K * (K + 1) / (n - K - 1),
                    "BIC": deviance + K * math.log(n),
                }
            )
        frame = pd.DataFrame(rows).sort_values("AICc", kind="stable", ignore_index=True)
        difference = frame["AICc"] - frame["AICc"].min()
        weight = np.exp(-difference / 2)
        return frame.assign(difference=difference, weight=weight / weight.sum())

    @cached_property
    def tests(self) -> pd.DataFrame:
        """An F-test for each pair of nested models.

        `p` is the probability that noise alone improves the larger model by as much.
        """
        columns = ["smaller", "larger", "F", "more", "freedom", "p"]
        rows = []
        for small, large in itertools.permutations(self.reports, 2):
            more = free_parameters(large) - free_parameters(small)
            if more <= 0 or not contains(large, small):
                continue
            n = len(large.problem.dataset)
            freedom = n - free_parameters(large)
            gained = max(0.0, n * (small.error**2 - large.error**2))
            F = gained / more / (n * large.error**2 / freedom)
            p = float(scipy.special.fdtrc(more, freedom, F))
            rows.append((small.problem.name, large.problem.name, F, more, freedom, p))
        return pd.DataFrame(rows, columns=columns)

    @cached_property
    def notes(self) -> list[str]:
        """Remarks on the preferred model and its margin, and on limits of the comparison."""
        sentences = [_preferred(self.table), *_by_bic(self.table)]
        for row in self.tests.to_dict("records"):
            fits = "fits" if row["p"] < SIGNIFICANT else "does not fit"
            sentences.append(
                f"{row['larger']} {fits} significantly better than {row['smaller']}, which it "
                f"contains: F({row['more']}, {row['freedom']}) = {row['F']:.3g}, "
                f"p = {row['p']:.2g}."
            )
        return sentences + self._cautions()

    def _cautions(self) -> list[str]:
        sentences = []
        for report in self.reports:
            name = report.problem.name
            if report.conclusion.doubt:
                sentences.append(
                    f"the optimum of {name} is in doubt ({report.conclusion.doubt}): a better "
                    "optimum would change its rank."
                )
            if report.at.at_bound.any() or len(report.at.null_directions):
                sentences.append(
                    f"{name} has parameters that are at a bound or that the data do not determine. "
                    "They are not counted, so its criteria and tests are approximate."
                )
        best = next(r for r in self.reports if r.problem.name == self.table["model"].iloc[0])
        if independence(best.problem, best.at, best.at):
            sentences.append(
                f"the errors of {best.problem.name} depend on each other, so the rows carry less "
                "information than independent rows would: all differences are too large, and p is "
                "too small. Do not choose by them."
            )
        sentences.append(
            "these criteria only rank the models: the report of the best one says whether it is "
            "adequate."
        )
        return sentences

    def __str__(self) -> str:
        """Tables and remarks as text."""
        parts = [self.table.to_string(index=False, float_format="%.5g")]
        if len(self.tests):
            parts.append(self.tests.to_string(index=False, float_format="%.3g"))
        return "\n\n".join([*parts, "\n".join(wrapped(f"- {note}") for note in self.notes)])


Compared = Report | Reporting
"""A fit, or its report."""


def compare_models(*reports: Compared | Mapping[str, Compared]) -> ModelComparison:
    """Compare models that were fitted to the same rows with the square loss.

    Parameters
    ----------
    *reports : Report or Fit, or mapping of str to Report or Fit
        At least two reports on the same rows of the same output, or fits, whose reports are made.
        The keys of a mapping replace the names of the functions.

    Returns
    -------
    ModelComparison
        Information criteria, F-tests of nested models, and remarks. Printing shows all of them.

    Raises
    ------
    ValueError
        If there are fewer than two reports, if two have the same name, if rows, sigma or losses
        differ or do not allow the comparison, or if a model reproduces the data exactly.

    References
    ----------
    Burnham and Anderson, Model Selection and Multimodel Inference, 2nd ed. 2002, Ch. 2 and 6.4.
    Bates and Watts, Nonlinear Regression Analysis, 1988, Ch. 3.10.

    Examples
    --------
    >>> import numpy as np
    >>> import miho
    >>> def decay(t, a, b):
    ...     return a * np.exp(-b * t)
    >>> def line(t, a, b):
    ...     return a - b * t
    >>> t = np.linspace(0, 2, 50)
    >>> y = decay(t, 2, 1.5) + 0.05 * np.random.default_rng(1).standard_normal(50)
    >>> fits = [miho.fit(model, t, y, {"a": (0, 5), "b": (0, 10)}) for model in (decay, line)]
    >>> miho.compare_models(*fits).table[["model", "difference"]].round()
       model  difference
    0  decay         0.0
    1   line       152.0
    """
    described = [report for compared in reports for report in _reports_of(compared)]
    if len(described) < 2:
        raise ValueError(f"compare_models: expected at least two reports, got {len(described)}")
    names = [report.problem.name for report in described]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(
                f"two reports are called {name!r}; give a mapping of names to reports, such as "
                "{'free': ..., 'fixed': ...}"
            )
    for report in described:
        _check_same_data(described[0], report)
        _check_same_sigma(described[0], report)
        _check_comparable(report)
    return ModelComparison(tuple(described))


def _reports_of(compared: Compared | Mapping[str, Compared]) -> list[Report]:
    """The report of a fit, or the reports of a mapping, whose problems have its names."""
    if not isinstance(compared, Mapping):
        return [report_of(compared)]
    reports = []
    for name, fit in compared.items():
        if name is None or not str(name).strip():
            raise ValueError(f"compare_models: a fit has the name {name!r}; expected words")
        report = report_of(fit)
        problem = copy.copy(report.problem)
        vars(problem).update(label=str(name))
        reports.append(replace(report, problem=problem))
    return reports


def _check_same_data(first: Report, second: Report) -> None:
    """Raise ValueError unless both fits used the same rows of the same output."""
    left, right = first.problem.dataset, second.problem.dataset
    same = left.output == right.output and not differ(first.problem.unit, second.problem.unit)
    if not same or not np.array_equal(left[left.output], right[right.output]):
        raise ValueError(
            f"{first.problem.name} and {second.problem.name} are fits of different data "
            f"({left.output} in {len(left)} rows of {left.name}, {right.output} in {len(right)} of "
            f"{right.name}); compare models on the same rows of the same output, and joint fits "
            "with joint fits"
        )


def _check_same_sigma(first: Report, second: Report) -> None:
    """Raise ValueError unless both fits used the same sigma."""
    left, right = first.problem, second.problem
    same = (left.sigma is None) == (right.sigma is None) and left.sigma_known == right.sigma_known
    if same and left.sigma is not None and right.sigma is not None:
        same = left.scale == right.scale and np.array_equal(_weights(left), _weights(right))
    if not same:
        raise ValueError(
            f"{left.name} and {right.name} have different sigma; give both fits, and each part of "
            "a joint fit, the same sigma"
        )


def _weights(problem: CurveFit) -> Array:
    return np.ones(1) if problem.weights is None else problem.weights


def _check_comparable(report: Report) -> None:
    """Raise ValueError for another loss, data without noise, or too few rows."""
    problem, k = report.problem, free_parameters(report)
    if not isinstance(problem.rho, Square):
        raise ValueError(
            f"{problem.name} has the loss {type(problem.rho).__name__}; expected Square, for which "
            "criteria and tests are defined"
        )
    if report.error <= rounding_of(problem):
        raise ValueError(
            f"{problem.name} reproduces every row to rounding, so there is no noise to compare with"
        )
    if len(problem.dataset) <= k + 2:
        raise ValueError(
            f"{problem.name}: {len(problem.dataset)} rows for {k} parameters; expected at least "
            f"{k + 3} rows"
        )


def free_parameters(report: Report) -> int:
    """Number of parameters that are not at a bound and that the data determine."""
    at = report.at
    return int((~at.at_bound).sum()) - len(at.null_directions)


def contains(large: Report, small: Report) -> bool:
    """Whether the larger model can follow the fitted curve of the smaller one within its space.

    It is fitted to that curve from its optimum, and from the smaller model's values of the
    parameters that both have, with the others at the optimum or at 0.
    """
    problem, theta = large.problem, large.at.theta
    curve = small.problem.model.predict(small.at.theta[None], *small.problem.inputs)[0]
    dataset = problem.dataset
    columns = {**dataset.columns, dataset.output: curve}
    exact = replace(problem, dataset=replace(dataset, columns=columns, held_out=None))
    shared = dict(zip(small.problem.space.names, small.at.theta, strict=True))
    starts = [theta]
    for others in (theta, np.zeros_like(theta)):
        named = dict(zip(problem.space.names, others, strict=True)) | shared
        starts.append(np.array([named[name] for name in problem.space.names]))
    target = REPRODUCED * len(dataset) * large.error**2
    return any(
        refit(exact, problem.space.clip(start), evaluations=EVALUATIONS).cost <= target
        for start in starts
    )


def _preferred(table: pd.DataFrame) -> str:
    best, second = table["model"].iloc[0], table["model"].iloc[1]
    difference = float(table["difference"].iloc[1])
    if difference <= LITTLE:
        return (
            f"{best} has the smallest AICc, but the AICc of {second} is only {difference:.2g} "
            "larger: the data hardly distinguish them."
        )
    support = "considerably less support" if difference < NONE else "hardly any support"
    return (
        f"{best} is preferred: {second}, the next by AICc, has an AICc {difference:.3g} larger and "
        f"{support}."
    )


def _by_bic(table: pd.DataFrame) -> list[str]:
    """A sentence if BIC prefers another model."""
    ranked = table.sort_values("BIC", kind="stable")
    if ranked.index[0] == 0:
        return []
    gap = float(table["BIC"].iloc[0] - ranked["BIC"].iloc[0])
    return [
        f"BIC, which penalises parameters more, prefers {ranked['model'].iloc[0]} by {gap:.2g}."
    ]
