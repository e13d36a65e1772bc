"""Methods and losses by their names on the command line."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable

import numpy as np

from miho.identification import Cauchy, Huber, Loss, Square
from miho.optim import MIHOGN, Budget, Optimizer
from miho.optim.refused_arguments import check_budget

METHODS = {
    "cluster_gauss_newton": "ClusterGaussNewton",
    "differential_evolution": "DifferentialEvolution",
    "dual_annealing": "DualAnnealing",
    "hickernell_yuan": "HickernellYuan",
    "hyperband": "Hyperband",
    "lbfgsb": "LBFGSB",
    "least_squares": "LeastSquares",
    "miho": "MIHO",
    "miho_gn": "MIHOGN",
    "miho_qn": "MIHOQN",
    "nelder_mead": "NelderMead",
    "pso_100": "PSO",
    "random": "RandomSearch",
    "scatter_search": "ScatterSearch",
    "successive_halving": "SuccessiveHalving",
    "tiktak": "TikTak",
    "variable_projection": "VariableProjection",
}
"""Class names in `miho.methods` of the methods that need no settings."""
EFFICIENT: dict[str, tuple[type[Huber | Cauchy], float]] = {
    "huber": (Huber, 1.345),
    "cauchy": (Cauchy, 2.385),
}
"""Class and relative scale of each robust loss. The scale, over the standard deviation of the
errors, keeps 95 % of the efficiency of least squares."""


def method_of(method: object, budget: Budget | None = None) -> Optimizer:
    """The method of a name, or the default one of None; a method itself is returned unchanged.

    Raises ValueError otherwise, and for a budget of another type.
    """
    check_budget(budget)
    if method is None:
        return MIHOGN()
    if isinstance(method, Optimizer):
        return method
    if isinstance(method, type):
        raise ValueError(f"method is the class {method.__name__}; write method={method.__name__}()")
    if not isinstance(method, str) or method not in METHODS:
        choices = _choices(method, METHODS)
        expected = f"a method, for example miho.methods.LeastSquares(), or {choices}"
        raise ValueError(f"method is {method!r}; expected {expected}")
    import miho.methods

    named: Optimizer = getattr(miho.methods, METHODS[method])()
    return named


def loss_of(loss: Loss | str | None, sigma: object = None) -> Loss:
    """The loss of a name; a loss itself is returned unchanged. Raises ValueError otherwise.

    The scale of a robust loss by name follows from the standard deviation `sigma` of the errors, a
    number or one for each row.
    """
    if loss is None or loss == "square":
        return Square()
    if isinstance(loss, Loss):
        return loss
    if not isinstance(loss, str) or loss not in EFFICIENT:
        names = ("square", *EFFICIENT)
        expected = f"miho.identification.Huber(scale=...), or {_choices(loss, names)}"
        raise ValueError(f"loss is {loss!r}; expected {expected}")
    kind, factor = EFFICIENT[loss]
    if sigma is None:
        raise ValueError(
            f"loss is {loss!r}, which needs a scale in the unit of the output; give the standard "
            f"deviation of the errors as sigma, or {factor} times it as "
            f"loss=miho.identification.{kind.__name__}(scale=...)"
        )
    if not np.all(np.asarray(sigma, dtype=float) > 0):
        raise ValueError("sigma is 0 or below in some row; expected numbers above 0")
    return kind(factor / math.sqrt(float(np.mean(1 / np.asarray(sigma, dtype=float) ** 2))))


def _choices(name: object, names: Iterable[str]) -> str:
    """The name closest to a misspelt one, or all names if none is close."""
    names = list(names)
    close = difflib.get_close_matches(name.lower(), names, 1) if isinstance(name, str) else []
    return f"{close[0]!r}: did you mean that?" if close else f"one of {', '.join(names)}"
