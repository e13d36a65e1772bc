"""MIHO: identify the parameters of a model from data, and compare identification methods."""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from miho.data import Dataset
    from miho.fitting import Fit, Part, fit, fit_joint, fit_many
    from miho.identification import CurveFit, compare_models
    from miho.online import Tracker
    from miho.optim import (
        MIHO,
        MIHOGN,
        MIHOQN,
        AskTell,
        Budget,
        LeastSquaresProblem,
        Optimizer,
        Oracle,
        Parameter,
        Problem,
        Space,
    )
    from miho.optim.minimize import minimize
    from miho.study import load_runs
    from miho.vehicle.models import load_tir

__all__ = [
    "MIHO", "MIHOGN", "MIHOQN", "AskTell", "Budget", "CurveFit", "Dataset", "Fit",
    "LeastSquaresProblem", "Optimizer", "Oracle", "Parameter", "Part", "Problem", "Space",
    "Tracker", "compare_models", "fit", "fit_joint", "fit_many", "load_runs", "load_tir",
    "minimize",
]  # fmt: skip

__getattr__, __dir__ = at_first_use(__name__)
