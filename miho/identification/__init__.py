"""Identification: problems of model, data and space, with reports, intervals and designs."""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from miho.identification.conclusion import linear_optimum
    from miho.identification.curve_fit import CurveFit
    from miho.identification.experimental_design import Design, optimal_design
    from miho.identification.irreducible import irreducible_error
    from miho.identification.model_comparison import ModelComparison, compare_models
    from miho.identification.parameters_file import identified
    from miho.identification.posterior import sample_posterior
    from miho.identification.report import Report
    from miho.identification.report_steps import make_report
    from miho.identification.residuals import Loss, Square
    from miho.identification.robust_loss import Cauchy, Huber
    from miho.identification.uncertainty import Linearised, linearised

__all__ = [
    "Cauchy", "CurveFit", "Design", "Huber", "Linearised", "Loss", "ModelComparison", "Report",
    "Square", "compare_models", "identified", "irreducible_error", "linear_optimum", "linearised",
    "make_report", "optimal_design", "sample_posterior",
]  # fmt: skip

__getattr__, __dir__ = at_first_use(__name__)
