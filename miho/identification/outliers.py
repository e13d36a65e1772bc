"""Remarks on outliers: rows far from the curve, and a scale of a robust loss that is too small."""

from __future__ import annotations

import math

import numpy as np

from miho.identification.curve_fit import CurveFit
from miho.identification.line_wrapping import with_unit
from miho.identification.loss import Square
from miho.identification.robust_loss import Cauchy, Huber
from miho.identification.uncertainty import Linearised
from miho.models.joint import parts_of

NORMAL = 0.6745
"""Median of the magnitude of normal errors of unit variance."""
HUBER = 1.345
"""Scale of Huber's loss in standard deviations: 95 % efficient for normal errors (Huber 1964)."""
FAR = 5.0
"""Rows beyond this many robust standard deviations may be outliers."""
MANY = 0.1
"""If more than this fraction of the rows is far, they are not outliers but a tail."""
RAISED = 1.3
"""Outliers matter if they raise the standard deviation of the errors by this factor."""
TREATED = 0.7
"""The scale of a robust loss is too small if it treats this fraction of the rows as outliers."""


def too_small_scale(problem: CurveFit, at: Linearised) -> list[str]:
    """A sentence if a robust loss treats most rows as outliers."""
    rho, errors = problem.rho, np.abs(problem.errors(at.theta))
    if not isinstance(rho, Huber | Cauchy) or np.mean(errors > rho.scale) < TREATED:
        return []
    usual = HUBER * float(np.median(errors)) / NORMAL
    return [
        f"{100 * np.mean(errors > rho.scale):.0f} % of the errors exceed the scale of the loss, so "
        f"the standard errors are unreliable: choose a larger scale, for example {usual:.2g} "
        f"{problem.unit}."
    ]


def outliers(problem: CurveFit, at: Linearised) -> list[str]:
    """A sentence if few rows are so far from the curve that they widen all intervals.

    With a known sigma intervals do not depend on the errors, so no row widens them. Fits with
    priors and joint fits have no sentence either, because they cannot have a robust loss.
    """
    if at.noise_known or problem.prior is not None or parts_of(problem.model):
        return []
    errors, unit = np.abs(problem.errors(at.theta)), problem.unit
    usual = float(np.median(errors)) / NORMAL * math.sqrt(errors.size / at.freedom)
    far = int(np.count_nonzero(errors > FAR * usual))
    few = 0 < far <= MANY * errors.size
    if not isinstance(problem.rho, Square) or not few or at.noise < RAISED * usual:
        return []
    size, scale = (with_unit(f"{x:.2g}", unit) for x in (usual, HUBER * usual))
    verbs = ("is", "widens") if far == 1 else ("are", "widen")
    return [
        f"{far} of {errors.size:,} rows {verbs[0]} more than {FAR:.0f} standard deviations of the "
        f"others, {size}, from the curve and {verbs[1]} all intervals. If these readings are "
        f"wrong, choose a robust loss, for example Huber's with the scale {scale}."
    ]
