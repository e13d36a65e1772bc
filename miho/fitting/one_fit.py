"""A fit in one call: from a function, columns and bounds to parameters, and how sure they are."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from miho.fitting.confirmed import by_calls, check_repeats
from miho.fitting.dear_fit import (
    JournalPath,
    as_begun,
    dear_fit,
    spread,
    title,
)
from miho.fitting.fit_result import Fit
from miho.fitting.known_start import best_known, check_start
from miho.fitting.named import check_budget, loss_of, method_of
from miho.fitting.search import searched
from miho.fitting.statement import DENSE, Tire, data_of, of_tire, space_of
from miho.identification.constraints import constrained, free_values
from miho.identification.curve_fit import CurveFit
from miho.identification.curve_fit_checks import ties_of
from miho.identification.loss import Loss
from miho.identification.refit import refit
from miho.identification.uncertainty import linearised
from miho.models.magic_formula import MagicFormula
from miho.models.model import Model
from miho.models.tied import Tied, whole_model
from miho.optim import Budget, Optimizer, Space
from miho.optim.gauss_newton_descent import descended as descended_by_machine
from miho.parallel import Evaluations, Workers

EDGE = 1e-6
"""A value this close to the end of a range, as a share of it, is at its edge."""
SETTLED, ROUNDS = 1e-6, 100
"""The deviation of the errors is estimated until it changes by less than this share, in so many
rounds at most."""


def fit(
    model: Model | Callable[..., Any] | Tire,
    x: Any,
    y: Any,
    space: Space | Mapping[str, Any] | Collection[str] | None = None,
    *,
    sigma: Any = None,
    sigma_known: bool = True,
    missing: Literal["raise", "drop"] = "raise",
    start: Mapping[str, float] | Literal["journal"] | None = None,
    fixed: Mapping[str, float] | None = None,
    tied: Mapping[str, str] | None = None,
    constraints: str | Sequence[str] = (),
    loss: Loss | str | None = None,
    method: Optimizer | str | None = None,
    budget: Budget | None = None,
    seed: int = 0,
    compiled: bool = True,
    workers: Workers = None,
    evaluation_limit: float | None = None,
    journal: JournalPath = None,
    convention: str = "iso-w",
    ranges: Mapping[str, Sequence[float] | None] | None = None,
) -> Fit:
    """Fit a model to data, within bounds and without a start, or from a start without a search.

        fit = miho.fit(lambda t, a, b: a * np.exp(-b * t), t, y, {"a": (0, 5), "b": (0, 10)})

    `model` is a function of input columns and then parameters, or a `Model`; annotations of a
    function that are strings are units. `x` is a column (N,), a tuple of columns, or a mapping or
    data frame of columns by name, and `y` (N,) or the name of one of its columns. `space` gives
    each parameter its bounds: (low, high), a mapping of the settings of `miho.Parameter`, such as
    {"low": 1, "high": 1e6, "scale": "log"}, or a `Parameter`. One with a default in the function,
    or bound by `functools.partial`, is fixed there without. `fixed` holds parameters at numbers;
    `tied` at expressions of others, which may be parameters of the space only. `constraints` are
    linear: "a < b < c", "a + b = 1", "b - a < 5", or several of them.

    `sigma` is the standard deviation of the errors: a number, one for each row (N,), or the name of
    a column of `x`; with `sigma_known` false up to a factor, which the residuals then tell. What
    priors count beside errors that are not known is settled with the fit. Rows in which a number is
    `missing` (NaN or masked) are refused, or left out with "drop", which a line on stderr counts.

    `method` searches within the bounds, `MIHOGN()` by default; it is one of `miho.methods`, or its
    name on the command line, such as "least_squares". With a `start` of every free
    parameter there is one descent from there, and bounds are not needed; with "journal" one from
    the best configuration that stands in the journal, whatever method evaluated it. `loss` is what
    a residual costs: its square, or one that outliers cannot dominate, such as
    `miho.identification.Huber(scale)`; where `sigma` is known, "huber" or "cauchy" will do. A
    function of arithmetic and NumPy's functions of numbers is searched by the machine of
    `miho.core`, any other one by steps in NumPy, as all are where `compiled` is false.

    A tire, `miho.load_tir` of a property file or its path, is a model too, of Fx, Fy or Mz as `y`
    names it; its coefficients that have bounds or a start are free, all others stay. Only named, as
    in ["PDY1", "PKY1"], they start from the tire's own values.

    Where an evaluation takes long, `workers` make them: a number of processes, -1 for one per core,
    an executor, or the address of a cluster; the result is the same. One that takes longer than
    `evaluation_limit` seconds has no value. In the file `journal` stands every evaluation that
    takes longer than some 10 ms, as soon as it is made: the same call makes only a few of them
    again, to see that the model is the same. One with other bounds, priors, sigma or another method
    knows them too, where it comes across the same configurations; one of another model or of other
    data is refused.

    Raises ValueError for what does not fit together, and where no finite value was found.
    """
    method = None if method is None else method_of(method)
    check_budget(budget)
    from_journal = isinstance(start, str)
    if isinstance(start, str):
        check_start(start, journal)
        start = None
    # A tire has bounds or a start of its own; anything else needs them by name.
    if isinstance(model, MagicFormula | str | os.PathLike):
        model, space, start = of_tire(model, x, y, space or (), start, fixed or {}, tied or {})
    elif isinstance(space, Collection) and not isinstance(space, Mapping | Space):
        raise ValueError(f"bounds are {space!r}; give them by name, as in {{'a': (0, 10)}}")
    named = space.names if isinstance(space, Space) else tuple(space or ())
    parameters = {*named, *(start or ()), *(fixed or ()), *(tied or ())}
    dataset, chosen, sigma = data_of(model, x, y, sigma, parameters, missing, convention, ranges)
    known = None if sigma is None or not sigma_known else sigma
    rho = loss_of(loss, dataset[known] if isinstance(known, str) else known)
    stated = chosen, space, start, fixed or {}, tied or {}
    sought = space_of(*stated)
    bounds = constrained(sought, constraints)
    own = sought
    if bounds.radial is not None:
        sought = space_of(*stated, reach=DENSE)
        bounds = constrained(sought, constraints)
    if constraints and start is not None:  # which is to blame before what it makes of the data
        free_values(bounds.free, ties_of(chosen, bounds), start)

    first: CurveFit | None = None  # whose model is known for what it is

    def problem_of(bounds: Space, prior_scale: float | None = None, dear: bool = True) -> CurveFit:
        known = chosen if first is None else whole_model(first.model)
        return CurveFit(
            known, dataset, bounds, rho, sigma=sigma, sigma_known=sigma_known,
            compiled=compiled, prior_scale=prior_scale, dear=dear,
        )  # fmt: skip

    # Beside errors that are not known, priors count by what the residuals say.
    settles = has_priors(bounds) and (sigma is None or not sigma_known)
    plain = without_priors(bounds) if settles else bounds
    first = as_begun(lambda dear: problem_of(plain, dear=dear), journal, evaluation_limit)
    with dear_fit(first, workers, evaluation_limit, journal) as evaluations:

        def solved(problem: CurveFit) -> Fit:
            if from_journal:
                return descended(problem, best_known(spread(problem, evaluations)), evaluations)
            if start is None:
                return searched(problem, method, budget, seed, evaluations)
            fit = descended(problem, start, evaluations)
            _check_within(sought, own, fit.values)
            return fit

        if not settles:
            return solved(first)
        return settled(bounds, lambda *box: solved(problem_of(*box)), evaluations)


def _check_within(sought: Space, own: Space, values: Mapping[str, float]) -> None:
    """Refuse an end at the edge of a range that is `sought` though it is not the parameter's own.

    It is no optimum: the edge is there because dense constraints need one.
    """
    for near, far in zip(sought.parameters, own.parameters, strict=True):
        slack = EDGE * (near.high - near.low)
        within = near.low + slack < values[near.name] < near.high - slack
        if (near.low, near.high) != (far.low, far.high) and not within:
            raise ValueError(
                f"constraints: {near.name} ends at {values[near.name]:g}, the edge of the range "
                f"from {near.low:g} to {near.high:g} about its start; give bounds"
            )


def settled(
    bounds: Space,
    solved: Callable[[Space, float | None], Fit],
    evaluations: Evaluations | None = None,
) -> Fit:
    """The fit beside priors whose weight depends on the errors, which are not known.

    `solved` fits within bounds, with priors that count beside errors of a standard deviation. That
    is estimated without priors first (Theil and Goldberger, International Economic Review 2, 1961),
    then from the residuals of the fit, in turn with the fit, with the degrees of freedom that
    `linearised` takes. Raises ValueError where it is not settled after ROUNDS.
    """

    def noise(fit: Fit) -> float:
        at = linearised(spread(fit.problem, evaluations), fit.theta)
        return max(at.noise, math.sqrt(fit.problem.rounding))

    fit = solved(bounds, noise(solved(without_priors(bounds), None)))
    for _ in range(ROUNDS):
        scale = noise(fit)
        before = fit.problem.prior_scale or scale
        if abs(scale - before) <= SETTLED * before:
            return replace(fit, run=fit.theta) if fit.descents is None else solved(bounds, scale)
        problem = replace(fit.problem, prior_scale=scale, dear=True)
        descent = refit(spread(problem, evaluations), fit.theta)
        fit = replace(fit, problem=problem, theta=descent.theta, moving=descent.moving)
    raise ValueError("the errors and what priors count beside them do not settle; give sigma")


def has_priors(space: Space) -> bool:
    """Whether anything is known besides the data."""
    return any(parameter.prior is not None for parameter in space.parameters)


def without_priors(space: Space) -> Space:
    """The same bounds, and nothing known besides."""
    return replace(space, parameters=tuple(replace(p, prior=None) for p in space.parameters))


def descended(
    problem: CurveFit, start: Mapping[str, float], evaluations: Evaluations | None = None
) -> Fit:
    """The optimum that a descent from a start of every free parameter leads to."""
    model = problem.model
    theta = np.array([float(start.get(name, 0.0)) for name in problem.space.names])
    if isinstance(model, Tied):
        theta = free_values(problem.space, model.ties, start)
    rows = problem.machine_rows
    if rows is not None:
        theta = descended_by_machine(rows, problem.space, theta)
    descent = refit(spread(problem, evaluations), theta)
    if not math.isfinite(descent.cost):
        raise ValueError(f"{title(problem)}: is not finite at the start; give another one")
    called = by_calls(problem, descent.theta[None], evaluations)
    if called is not None:
        return descended(called, start)
    check_repeats(problem, descent.theta, descent.cost, evaluations)
    return Fit(problem, descent.theta, descent.theta, moving=descent.moving)
