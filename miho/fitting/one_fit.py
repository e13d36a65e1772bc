"""Fit one model to data: from a function, columns and bounds to values and standard errors."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

from miho.fitting.arguments import DENSE, by_label, data_of, space_of
from miho.fitting.fit_result import Fit
from miho.fitting.search import searched, spread
from miho.identification.curve_fit import CurveFit
from miho.identification.residuals import Loss, Square
from miho.models.model import Model
from miho.optim import Budget, Optimizer, Space

if TYPE_CHECKING:
    from miho.fitting.expensive_fit import JournalPath
    from miho.fitting.protocols import Template
    from miho.parallel import Evaluations, Workers


def fit(
    model: Model | Callable[..., Any] | Template | str | os.PathLike[str],
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
    """Fit a model to data: a global search within bounds, or one descent from a start.

    The search needs no starting values: it descends from many points within the bounds until enough
    of the descents agree on the best optimum [1]_. With a `start`, it makes one descent.

    Parameters
    ----------
    model : Model, callable, Template or path
        A function ``f(x, ..., a, b, ...)`` of input columns, then parameters, or a `Model`. String
        annotations of a function are units. A tire from `miho.load_tir`, or the path of its
        property file, is also a model, of Fx, Fy or Mz as named by `y`; its coefficients are free
        if they have bounds or a start.
    x : array_like, tuple, mapping, DataFrame or Dataset
        Input columns, (N,) each: one column, a tuple of columns, or columns by name.
    y : array_like of shape (N,) or str
        Measured output, or the name of its column in `x`.
    space : Space, mapping of str, or collection of str, optional
        Bounds of each parameter by name: (low, high), a `Parameter`, or a mapping of its settings,
        for example ``{"low": 1, "high": 1e6, "scale": "log"}``. A parameter without bounds is fixed
        to its default in the function, or to its value in `functools.partial`. For a tire a
        collection of names is enough: these coefficients start from the tire's values.
    sigma : float, array_like of shape (N,) or str, optional
        Standard deviation of the errors of `y`, in the same unit: a number, a value for each row,
        or the name of a column of `x`. By default the residuals estimate it.
    sigma_known : bool, optional
        Whether `sigma` is absolute. If false, the residuals estimate a common factor of all
        values, which also determines the weight of priors.
    missing : {"raise", "drop"}, optional
        Treatment of rows with a missing number (NaN or masked). "drop" omits them and reports their
        number on stderr.
    start : mapping of str to float, or "journal", optional
        A value for each free parameter: the fit is one descent from it, and bounds are not needed.
        "journal" descends from the best configuration in the `journal`, by any method.
    fixed : mapping of str to float, optional
        Parameters that are fixed to numbers.
    tied : mapping of str to str, optional
        Parameters that are tied to expressions of other parameters, for example ``{"b": "2 * a"}``.
        Expressions may use parameters that occur in `space` only.
    constraints : str or sequence of str, optional
        Linear constraints, for example "a < b < c", "a + b = 1" or "b - a < 5".
    loss : Loss or str, optional
        Loss of a residual: its square by default, or a robust loss, for example
        ``miho.identification.Huber(scale)``. "huber" and "cauchy" need a known `sigma`, which
        determines their scale.
    method : Optimizer or str, optional
        The search method, `MIHOGN()` by default: a method of `miho.methods`, or its name on the
        command line, for example "least_squares".
    budget : Budget, optional
        Limit on evaluations or seconds.
    seed : int, optional
        Seed of the search; the same seed gives the same result.
    compiled : bool, optional
        Whether the virtual machine of `miho.core` runs the search if the model is a formula, that
        is, arithmetic and NumPy's functions of numbers. Other models, and all models if false, are
        searched with NumPy.
    workers : int, str, executor or callable, optional
        Workers for expensive models: a number of processes (-1 for one per core), an executor, or
        the address of a cluster. The result does not depend on them.
    evaluation_limit : float, optional
        Time limit of an evaluation, in seconds; a longer evaluation has no value.
    journal : path, optional
        File that stores every evaluation longer than about 10 ms. A second call reuses them and
        repeats only a few, to check that the model is unchanged. Other bounds, priors, sigma and
        methods may share the file; another model or other data raise an error.
    convention : str, optional
        Sign convention of the data of a tire, ISO-W by default.
    ranges : mapping of str, optional
        For a tire, the plausible range of a column, (low, high); None accepts every value.

    Returns
    -------
    Fit
        The optimum, with its standard errors, predictions, figures and report.

    Raises
    ------
    ValueError
        If model, data, bounds and settings do not fit together, or if no finite value was found.
    JournalError
        If the journal belongs to another model or other data.

    See Also
    --------
    fit_joint : Several datasets with common parameters.
    fit_many : Many small datasets of one model.

    References
    ----------
    .. [1] C. G. E. Boender, A. H. G. Rinnooy Kan, "Bayesian stopping rules for multistart global
       optimization methods", Mathematical Programming 37 (1987) 59-80.

    Examples
    --------
    >>> import numpy as np
    >>> import miho
    >>> t = np.linspace(0, 2, 50)
    >>> y = 2 * np.exp(-1.5 * t)
    >>> fit = miho.fit(lambda t, a, b: a * np.exp(-b * t), t, y, {"a": (0, 5), "b": (0, 10)})
    >>> {name: round(value, 4) for name, value in fit.values.items()}
    {'a': 2.0, 'b': 1.5}

    A descent from a start, as with `scipy.optimize.curve_fit`:

    >>> fit = miho.fit(lambda t, a, b: a * np.exp(-b * t), t, y, start={"a": 1, "b": 1})
    >>> round(fit.values["b"], 4)
    1.5
    """
    if not (method is None and budget is None):
        from miho.fitting.named import method_of

        method = method_of(method, budget)
    from_journal = isinstance(start, str)
    if isinstance(start, str):
        from miho.fitting.expensive_fit import check_start

        check_start(start, journal)
        start = None
    start, fixed = by_label("start", start), by_label("fixed", fixed)
    tied = by_label("tied", tied)
    fixed, tied = fixed or {}, tied or {}
    if not callable(model) and not isinstance(model, Model):
        from miho.fitting.protocols import model_from

        model, space, start = model_from(model, x, y, space or (), start, fixed, tied)
    if isinstance(space, Collection) and not isinstance(space, Mapping | Space):
        kind = type(space).__name__
        raise ValueError(f"bounds are of type {kind}; give them by name, as in {{'a': (0, 10)}}")

    # The data, and the loss of a residual.
    stated = space, tied, start, fixed
    dataset, chosen, sigma = data_of(model, x, y, sigma, missing, convention, ranges, stated)
    known = None if sigma is None or not sigma_known else sigma
    rho: Loss = Square()
    if loss is not None:
        from miho.fitting.named import loss_of

        rho = loss_of(loss, dataset[known] if isinstance(known, str) else known)
    # The space; without bounds, dense constraints need a narrower one.
    arguments = chosen, space, start, fixed, tied
    own = sought = bounds = space_of(*arguments)
    if constraints or not isinstance(constraints, tuple):
        from miho.identification.constraints import constrained, free_values

        bounds = constrained(sought, constraints)
        if bounds.radial is not None:
            sought = space_of(*arguments, reach=DENSE)
            bounds = constrained(sought, constraints)
        if start is not None:  # a bad start is reported before the model is called
            from miho.identification.ties import ties_of

            free_values(bounds.free, ties_of(chosen, bounds), start)

    # The problem. If sigma is unknown, the residuals determine the weight of priors.
    settles = bounds.has_priors and (sigma is None or not sigma_known)
    plain = bounds.without_priors if settles else bounds

    def problem_of(expensive: bool) -> CurveFit:
        return CurveFit(
            chosen, dataset, plain, rho, sigma=sigma, sigma_known=sigma_known, compiled=compiled,
            expensive=expensive,
        )  # fmt: skip

    # The search or the descent, with workers and a journal if there are any.
    opened: AbstractContextManager[Evaluations | None] = nullcontext()
    if workers is None and evaluation_limit is None and journal is None:
        first = problem_of(expensive=False)
    else:
        from miho.fitting.expensive_fit import as_begun, expensive_fit

        first = as_begun(problem_of, journal, evaluation_limit)
        opened = expensive_fit(first, workers, evaluation_limit, journal)
    with opened as evaluations:

        def solved(problem: CurveFit) -> Fit:
            at = start
            if from_journal:
                from miho.fitting.expensive_fit import best_known

                at = best_known(spread(problem, evaluations))
            if at is None:
                return searched(problem, method, budget, seed, evaluations)
            from miho.fitting.one_descent import descended

            fit = descended(problem, at, evaluations)
            if sought is not own:
                from miho.identification.constraints import check_within

                check_within(sought, own, fit.values)
            return fit

        if not settles:
            return solved(first)
        from miho.fitting.prior_weight import settled

        def weighed(box: Space, scale: float | None) -> Fit:
            whole = first.model.whole  # which has been examined
            return solved(replace(first, model=whole, space=box, prior_scale=scale, expensive=True))

        return settled(bounds, weighed, evaluations)
