"""Checks of the standard deviation of the errors, which weighs residuals and priors."""

from __future__ import annotations

import numpy as np

from miho.identification.curve_fit import CurveFit
from miho.identification.curve_fit_checks import LARGEST, SMALLEST
from miho.identification.residuals import Square
from miho.units import differ
from miho.validate import is_number


def check_sigma(problem: CurveFit) -> None:
    """Raise ValueError for a sigma that is not a positive number or a column of such numbers."""
    sigma = problem.sigma
    if problem.prior is not None:
        _check_prior(problem)
    if sigma is None:
        return
    if not isinstance(sigma, str):
        if not is_number(sigma) or not 0 < sigma < np.inf:
            raise ValueError(f"sigma is {sigma!r}; expected a number above 0, or a column's name")
        if not SMALLEST < sigma < LARGEST:
            raise ValueError(f"sigma is {sigma!r}; expected {SMALLEST:g} to {LARGEST:g}")
        return
    column, dataset = problem.dataset[sigma], problem.dataset
    if sigma in problem.model.inputs or sigma == dataset.output:
        raise ValueError(
            f"sigma is {sigma!r}, an input or the output of the model; name a column of standard "
            "deviations"
        )
    label = "sigma" if sigma == "sigma" else f"sigma: column {sigma!r}"
    if differ(dataset.units[sigma], problem.unit):
        raise ValueError(
            f"{label} has the unit {dataset.units[sigma]!r}; expected {problem.unit!r}, the unit "
            f"of {dataset.output!r}"
        )
    beyond = (column < SMALLEST) | (column > LARGEST)
    for wrong, expected in (
        (column <= 0, "numbers above 0"),
        (beyond, f"{SMALLEST:g} to {LARGEST:g}"),
    ):
        if wrong.any():
            row = int(np.argmax(wrong))
            raise ValueError(
                f"{label} is {column[row]:g} in row {row + 1} of {dataset.name}; "
                f"expected {expected}"
            )


def _check_prior(problem: CurveFit) -> None:
    """Refuse priors whose weight relative to the data is unknown."""
    name = problem.prior.parameters[0].name if problem.prior is not None else ""
    if problem.prior_scale is None and (problem.sigma is None or not problem.sigma_known):
        raise ValueError(
            f"space.{name}.prior: expected a known sigma, which sets the weight of the prior "
            "against the data; give sigma, a number or a column, or use miho.fit, which estimates "
            "it"
        )
    if not isinstance(problem.rho, Square):
        raise ValueError(
            f"space.{name}.prior: expected the loss Square, got {type(problem.rho).__name__}; "
            "remove the prior or change the loss"
        )
