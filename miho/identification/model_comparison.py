"""Comparing models on the same data: information criteria, and F-tests where one contains another.

Criteria are those of normal errors of one unknown variance, which counts as a parameter (Burnham
and Anderson, Model Selection and Multimodel Inference, 2nd ed. 2002, Ch. 2 and 6.4), so that they
agree with R's `AIC` and `BIC`; the F-test is that of Bates and Watts (Nonlinear Regression
Analysis, 1988, Ch. 3.10).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
import scipy  # which loads its packages where they are used: importing them takes a second

from miho.identification.curve_fit import CurveFit
from miho.identification.flags import independence
from miho.identification.loss import Square
from miho.identification.refit import refit
from miho.identification.report import Report, rounding_of
from miho.quantities import Array

REPRODUCED = 1e-6
"""A model contains another if it follows the other's curve to this fraction of the sum of squares
of its own errors."""
EVALUATIONS = 2000
LITTLE, NONE = 2.0, 10.0
"""Differences of AICc up to which a model has substantial support, and from which on hardly any
(Burnham and Anderson 2002, p. 70)."""
SIGNIFICANT = 0.05


@dataclass(frozen=True, eq=False)
class ModelComparison:
    """Several reports on the same rows; tables and sentences are functions of them."""

    reports: tuple[Report, ...]

    @cached_property
    def table(self) -> pd.DataFrame:
        """A row per model, the smallest AICc first.

        Free parameters, the sum of squared errors, its residual standard deviation in the output's
        unit, AIC, AICc, BIC, the difference of AICc to the smallest, and Akaike's weight: how
        probable it is that this is the best of the models for further data.
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
        """An F-test for each pair of which one model contains the other, its curve being the same.

        `p` is how often noise alone would make the larger model as much better.
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
        """Which model is preferred and by how much, and where not to rely on it."""
        sentences = [_preferred(self.table), *_by_bic(self.table)]
        for row in self.tests.to_dict("records"):
            verdict = "is worth" if row["p"] < SIGNIFICANT else "is not shown to be worth"
            parameters = f"{row['more']} more parameter{'s' * (row['more'] != 1)}"
            sentences.append(
                f"{row['larger']}, which contains {row['smaller']}, {verdict} its {parameters}: "
                f"F({row['more']}, {row['freedom']}) = {row['F']:.3g}, p = {row['p']:.2g}."
            )
        return sentences + self._cautions()

    def _cautions(self) -> list[str]:
        sentences = []
        for report in self.reports:
            name = report.problem.name
            if report.standing.doubt:
                sentences.append(
                    f"the optimum of {name} is in doubt ({report.standing.doubt}): a better one "
                    "would change its rank."
                )
            if report.at.at_bound.any() or len(report.at.null_directions):
                sentences.append(
                    f"of {name} only the parameters that the data determine are counted, and none "
                    "at a bound; criteria and tests are rough then."
                )
        best = next(r for r in self.reports if r.problem.name == self.table["model"].iloc[0])
        if independence(best.problem, best.at):
            sentences.append(
                f"the errors of {best.problem.name} depend on each other, so that the rows say "
                "less than their number: all differences are too large, and p too small. Do not "
                "choose by them."
            )
        sentences.append(
            "criteria rank these models, and do not say that the best of them is right: its report "
            "does."
        )
        return sentences

    def __str__(self) -> str:
        """Tables and sentences."""
        parts = [self.table.to_string(index=False, float_format="%.5g")]
        if len(self.tests):
            parts.append(self.tests.to_string(index=False, float_format="%.3g"))
        return "\n\n".join([*parts, "\n".join(f"- {note}" for note in self.notes)])


def compare_models(*reports: Report) -> ModelComparison:
    """The comparison of models that were fitted to the same rows by the square loss.

    Raises ValueError if there are less than two, if data, losses or names do not allow it, or if a
    model reproduces the data exactly.
    """
    if len(reports) < 2:
        raise ValueError(f"{len(reports)} report to compare; give at least two")
    names = [report.problem.name for report in reports]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"two reports are called {name!r}; give one CurveFit another label")
    for report in reports:
        _check_same_data(reports[0], report)
        _check_same_sigma(reports[0], report)
        _check_comparable(report)
    return ModelComparison(tuple(reports))


def _check_same_data(first: Report, second: Report) -> None:
    """Raise ValueError unless both are of the same rows of the same output."""
    left, right = first.problem.dataset, second.problem.dataset
    same = left.output == right.output and first.problem.unit == second.problem.unit
    if not same or not np.array_equal(left[left.output], right[right.output]):
        raise ValueError(
            f"{first.problem.name} and {second.problem.name} are fits of different data "
            f"({left.output} in {len(left)} rows of {left.name}, {right.output} in {len(right)} of "
            f"{right.name}); compare models on the same rows of the same output"
        )


def _check_same_sigma(first: Report, second: Report) -> None:
    """Raise ValueError unless both take the errors of the rows for the same."""
    left, right = first.problem, second.problem
    same = (left.sigma is None) == (right.sigma is None) and left.sigma_known == right.sigma_known
    if same and left.sigma is not None and right.sigma is not None:
        same = left.scale == right.scale and np.array_equal(_weights(left), _weights(right))
    if not same:
        raise ValueError(
            f"{left.name} and {right.name} have different sigma; compare models with the same"
        )


def _weights(problem: CurveFit) -> Array:
    return np.ones(1) if problem.weights is None else problem.weights


def _check_comparable(report: Report) -> None:
    """Raise ValueError where criteria are none: another loss, no noise, or too few rows."""
    problem, k = report.problem, free_parameters(report)
    if not isinstance(problem.rho, Square):
        raise ValueError(
            f"{problem.name} has the loss {type(problem.rho).__name__}; criteria and tests are "
            "those of Square"
        )
    if report.error <= rounding_of(problem):
        raise ValueError(
            f"{problem.name} reproduces every row to rounding, so there is no noise to compare with"
        )
    if len(problem.dataset) <= k + 2:
        raise ValueError(
            f"{problem.name}: {len(problem.dataset)} rows for {k} parameters; a comparison needs "
            "at least three more"
        )


def free_parameters(report: Report) -> int:
    """Parameters that the fit had free: none at a bound, none that the data do not determine."""
    at = report.at
    return int((~at.at_bound).sum()) - len(at.null_directions)


def contains(large: Report, small: Report) -> bool:
    """Whether the larger model can follow the smaller one's fitted curve exactly, in its space.

    It is fitted to that curve: from its own optimum, and from the smaller one's parameters of the
    same names with the others as they are or at 0.
    """
    problem, theta = large.problem, large.at.theta
    curve = small.problem.model.predict(small.at.theta[None], *small.problem.inputs)[0]
    dataset = problem.dataset
    columns = {**dataset.columns, dataset.output: curve}
    exact = replace(problem, dataset=replace(dataset, columns=columns, held_out=None))
    shared = dict(zip(small.problem.space.names, small.at.theta, strict=True))
    starts = [theta] + [
        np.array(
            [
                shared.get(name, other)
                for name, other in zip(problem.space.names, others, strict=True)
            ]
        )
        for others in (theta, np.zeros_like(theta))
    ]
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
            f"{best} has the smallest AICc, but {second} is only {difference:.2g} behind: the data "
            "hardly tell them apart."
        )
    support = "considerably less support" if difference < NONE else "hardly any support"
    return (
        f"{best} is preferred: {second}, the next by AICc, is {difference:.3g} behind, which "
        f"leaves it {support}."
    )


def _by_bic(table: pd.DataFrame) -> list[str]:
    """A sentence if BIC prefers another model."""
    ranked = table.sort_values("BIC", kind="stable")
    if ranked.index[0] == 0:
        return []
    gap = float(table["BIC"].iloc[0] - ranked["BIC"].iloc[0])
    return [
        f"by BIC, which asks more of each parameter, it is {ranked['model'].iloc[0]}, by {gap:.2g}."
    ]
