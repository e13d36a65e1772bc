"""The steps from the result of a run to its report."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from miho.identification.alternatives import minima_at
from miho.identification.bootstrap import replicated
from miho.identification.closed_form import linear_optimum
from miho.identification.curve_fit import CurveFit
from miho.identification.deadline import Deadline, seconds_of_refit
from miho.identification.flags import REMEDY
from miho.identification.optimum import BOOTSTRAP, CHECK, PROFILE, conclusion_on
from miho.identification.profile_likelihood import (
    SIGNS,
    Profile,
    ProfileSide,
    joined,
    likelihood_profile,
)
from miho.identification.refit import OutOfTimeError, Refit, refit
from miho.identification.report import Report, rounding_of
from miho.identification.stated import profiled_parameters, reported_space
from miho.identification.uncertainty import Linearised, linearised
from miho.identification.validation import conditions, leave_one_out, root_mean_square
from miho.identification.within_noise import optima_within_noise
from miho.optim import Descents, Minimum, in_optimum
from miho.parallel import Pool, Workers, open_pool
from miho.parallel.blocks import in_blocks
from miho.parallel.process_executor import WorkerLostError
from miho.quantities import Array

MOST_PROFILES = 10
"""Models with more parameters are profiled only on request: each end costs several refits."""
EVALUATIONS = 5000
"""Largest number of evaluations of the descent to the reported optimum."""
REFITS = 4
"""Smallest number of refits that a side of a profile needs."""
SECONDS = 60.0
"""Default time limit, in seconds, of the results that a report computes by default."""


def make_report(
    problem: CurveFit,
    run: Array,
    *,
    descents: Descents | None = None,
    check: Descents | None = None,
    better: Array | None = None,
    optimum: Array | None = None,
    moving: int = 0,
    found_by: str = "",
    minima: Sequence[Minimum] = (),
    best_known: float | None = None,
    replicates: int = 0,
    profiles: bool | None = None,
    level: float = 0.95,
    seed: int = 0,
    seconds: float = SECONDS,
    remedy: str = REMEDY,
    progress: Callable[[str], object] = lambda stage: None,
    workers: Workers = None,
) -> Report:
    """Report the optimum near the result of a run.

    If a profile or the bootstrap finds a better optimum, the report describes that one and says
    so. If the data cannot distinguish further minima from the optimum, the report includes them,
    and all intervals cover them.

    Parameters
    ----------
    problem : CurveFit
        The problem of the run.
    run : ndarray of shape (d,)
        The final parameters of the run.
    descents, check : Descents, optional
        The ends of the descents of the run, and of a check of the run.
    better : ndarray of shape (d,), optional
        The result of the check. The report describes the optimum near it if that is better.
    optimum : ndarray of shape (d,), optional
        The end of an earlier descent from `run`; the descent of the report starts there.
    moving : int, optional
        Evaluations after which the descent to `optimum` was still improving; 0 if it converged.
    found_by : str, optional
        The step after the search that found `optimum`; empty if the search found it.
    minima : sequence of Minimum, optional
        Further minima to compare with the optimum.
    best_known : float, optional
        Loss of a recorded optimum.
    replicates : int, optional
        Number of bootstrap estimates: 0 for none, 1000 for intervals. Dependent rows are drawn in
        blocks.
    profiles : bool, optional
        Whether to compute profile likelihoods. By default for up to MOST_PROFILES parameters;
        never for data in events.
    level : float, optional
        Confidence level of all intervals, between 0 and 1.
    seed : int, optional
        Seed of the bootstrap.
    seconds : float, optional
        Time limit of the results that are computed by default. `Report.omitted` lists the results
        that are missing then. Profiles and replicates that are requested have no limit.
    remedy : str, optional
        Advice if the optimum is in doubt.
    progress : callable, optional
        Called with the name of the stage before each step.
    workers : optional
        Workers as in `miho.fit`, which share expensive profiles, replicates and refits. The report
        is the same.

    Returns
    -------
    Report
        Optimum, intervals, tables and remarks.

    Raises
    ------
    ValueError
        If there are fewer rows than parameters, or derivatives are not finite, so that there are no
        standard errors; if `level` is not between 0 and 1; or if a problem with priors has
        `replicates`.
    """
    if not 0 < level < 1:
        raise ValueError(f"level is {level!r}; expected a number between 0 and 1, for example 0.95")
    if replicates and problem.prior is not None:
        raise ValueError(
            f"replicates is {replicates}; expected 0 for a problem with priors, which resampled "
            "rows ignore; use profile intervals instead"
        )
    # The optimum comes first, because every other result describes it.
    deadline = Deadline(time.perf_counter() + seconds)
    progress("optimum")
    descent = _optimum(problem, run if optimum is None else optimum, deadline)
    if optimum is not None and deadline.over and not descent.converged:
        # Without time for a new descent, the state of the earlier one counts.
        descent = descent._replace(converged=not moving, evaluations=moving)
    best = _Best(descent, found_by)
    if better is not None:
        best = best.or_better(problem, _optimum(problem, better, deadline), CHECK)
    searches = tuple(search for search in (descents, check) if search is not None)
    minima = [*minima, *(minimum for search in searches for minimum in search.minima)]
    with open_pool(workers) as pool:
        work = _Work(deadline, progress, pool, _omission(seconds))
        while True:
            best, optima, curves, omitted = _profiled(problem, best, minima, level, profiles, work)
            at = optima[0]
            # Fits without some rows, and the bootstrap, use the time that is left.
            left_out, unfinished = _left_out(problem, at, work)
            estimates = None
            if replicates:
                estimates = replicated(problem, optima, replicates, seed, progress, pool)
            earlier, best = best, _best_of_replicates(problem, best, estimates, deadline)
            if best is earlier:
                break
            minima += minima_at(problem, optima)
    reported = reported_space(problem.space).names
    exact = linear_optimum(problem)
    best_known = best_known if exact is None else exact[1]
    return Report(
        problem=problem,
        run=run,
        at=at,
        others=optima[1:],
        conclusion=conclusion_on(
            problem,
            at.theta,
            run,
            searches,
            at=at,
            moving=best.descent.moving,
            found_by=best.found_by,
            best_known=best_known,
        ),
        profiles=tuple(curves.get(name) for name in reported),
        tied_profiles={name: curve for name, curve in curves.items() if name not in reported},
        replicates=estimates,
        left_out=left_out,
        level=level,
        omitted=(*omitted, *unfinished),
        remedy=remedy,
        searches=searches,
        best_known=best_known,
        moving=best.descent.moving,
        found_by=best.found_by,
    )


@dataclass(frozen=True)
class _Best:
    """The best optimum so far, and the step that found it if the search did not."""

    descent: Refit
    found_by: str = ""

    def or_better(self, problem: CurveFit, other: Refit, found_by: str) -> _Best:
        """The better of the two; `self` if both are the same optimum."""
        rounding = problem.resolution * problem.residual_count
        same = in_optimum(other.cost, self.descent.cost, rounding)
        return self if same else _Best(other, found_by)


@dataclass(frozen=True)
class _Work:
    """The deadline, the progress callback, the pool and the remark on missing results."""

    deadline: Deadline
    progress: Callable[[str], object]
    pool: Pool | None
    too_late: str


def _profiled(
    problem: CurveFit,
    best: _Best,
    minima: Sequence[Minimum],
    level: float,
    requested: bool | None,
    work: _Work,
) -> tuple[_Best, tuple[Linearised, ...], dict[str, Profile], list[str]]:
    """The best optimum, the uncertainties of all optima within the noise, profiles, and remarks.

    If a refit of a profile finds a better optimum, everything is computed again from there.
    """
    while True:
        within = optima_within_noise(problem, best.descent, minima, level, work.deadline)
        optima = tuple(_uncertainty(problem, fit.theta) for fit in within)
        best = replace(best, descent=within[0])
        curves, omitted = _profiles(problem, optima, level, requested, work)
        refits = (curve.best for curve in curves.values())
        lowest = min(refits, key=lambda fit: fit.cost, default=best.descent)
        if best.or_better(problem, lowest, PROFILE) is best:
            return best, optima, curves, omitted
        work.progress("better optimum")
        minima = [*minima_at(problem, optima), *minima]
        best = _Best(_optimum(problem, lowest.theta, work.deadline), PROFILE)


def _best_of_replicates(
    problem: CurveFit, best: _Best, estimates: Array | None, deadline: Deadline
) -> _Best:
    """The best optimum so far, or a better one near the best of the replicates (n, d).

    A replicate is the optimum of resampled data and may lie in a lower basin of the data.
    """
    if estimates is None:
        return best
    losses = np.nan_to_num(problem.loss(estimates), nan=np.inf)
    if best.descent.cost <= losses.min() * problem.residual_count:
        return best
    lowest = _optimum(problem, estimates[np.argmin(losses)], deadline)
    return best.or_better(problem, lowest, BOOTSTRAP)


def _left_out(problem: CurveFit, at: Linearised, work: _Work) -> tuple[pd.DataFrame, list[str]]:
    """Errors on groups of rows, each from a fit without the group, and remarks on missing ones."""
    tables: list[pd.DataFrame] = []
    omitted: list[str] = []
    held = np.flatnonzero(at.unidentifiable).tolist()
    for condition in conditions(problem):
        work.progress(f"leave one {condition} out")
        try:
            tables.append(
                leave_one_out(problem, at.theta, condition, held, work.deadline, work.pool)
            )
        except OutOfTimeError:
            return _stacked(tables), [*omitted, f"errors with {condition} {work.too_late}"]
        except WorkerLostError as error:
            omitted.append(f"errors with {condition} {_lost(error)}")
    return _stacked(tables), omitted


def _stacked(tables: list[pd.DataFrame]) -> pd.DataFrame:
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def _uncertainty(problem: CurveFit, theta: Array) -> Linearised:
    """The uncertainty of an optimum (d,), allowing for correlated neighbouring rows.

    Rounding errors may be correlated too, so the correlation is ignored if all errors are rounding.
    """
    neighbours = root_mean_square(problem.errors(theta)) > rounding_of(problem)
    return linearised(problem, theta, neighbours)


def _profiles(
    problem: CurveFit,
    optima: Sequence[Linearised],
    level: float,
    requested: bool | None,
    work: _Work,
) -> tuple[dict[str, Profile], list[str]]:
    """The profiles by parameter, and remarks on missing ones.

    Parameters that are at a bound or unidentifiable at all optima have no profile. There are no
    profiles for data in events, or if the errors are rounding.
    """
    curves: dict[str, Profile] = {}
    at, *others = optima
    by_default = len(problem.space) <= MOST_PROFILES
    if at.events or at.noise <= rounding_of(problem):
        return curves, []
    possible: dict[str, int | str] = {}
    for optimum in optima:
        possible |= profiled_parameters(problem, optimum)
    names = list(possible) if (by_default if requested is None else requested) else []
    limit = None if requested else work.deadline
    if work.pool is not None:
        return _profiles_by_workers(
            problem, optima, level, {n: possible[n] for n in names}, limit, work
        )
    for done, name in enumerate(names):
        work.progress(f"profile of {name}")
        try:
            curves[name] = likelihood_profile(problem, at, possible[name], level, limit, others)
        except OutOfTimeError:
            late = ", ".join(names[done:])
            return curves, [f"profile intervals of {late} {work.too_late}"]
    return curves, []


def _profiles_by_workers(
    problem: CurveFit,
    optima: Sequence[Linearised],
    level: float,
    parameters: Mapping[str, int | str],
    limit: Deadline | None,
    work: _Work,
) -> tuple[dict[str, Profile], list[str]]:
    """The result of `_profiles` from workers; each side of each profile is one task."""
    check = (lambda: None) if limit is None else limit.check
    at, *others = optima
    sides = in_blocks(
        work.pool,
        ProfileSide(problem, at, level, limit, others),
        [(of, sign) for of in parameters.values() for sign in SIGNS],
        REFITS * seconds_of_refit(problem, at.theta),
        check,
    )
    curves: dict[str, Profile] = {}
    late: list[str] = []
    omitted: list[str] = []
    for name in parameters:
        work.progress(f"profile of {name}")
        try:
            lower, upper = (next(sides, None) for _ in SIGNS)
        except OutOfTimeError:  # which ends `sides`
            lower = upper = None
        lost = next((side for side in (lower, upper) if isinstance(side, WorkerLostError)), None)
        if lost is not None:
            omitted.append(f"profile intervals of {name} {_lost(lost)}")
        elif lower is None or upper is None:
            late.append(name)
        else:
            curves[name] = joined(lower, upper)
    if late:
        omitted.append(f"profile intervals of {', '.join(late)} {work.too_late}")
    return curves, omitted


def _optimum(problem: CurveFit, start: Array, deadline: Deadline) -> Refit:
    """The optimum near `start` (d,), or the point that the descent reached before the deadline.

    Parameters without an effect at the start are fixed, so they keep the value of the run.
    """
    derivatives = problem.jacobian(problem.space.clip(start))
    ineffective = np.flatnonzero(~derivatives.any(axis=0)).tolist()
    return refit(problem, start, fixed=ineffective, evaluations=EVALUATIONS, deadline=deadline)


def _omission(seconds: float) -> str:
    """The end of a sentence on results that the time limit excluded."""
    return (
        f"are left out: the time limit of {seconds:g} s is over (--seconds {10 * seconds:g} raises "
        "it)."
    )


def _lost(error: WorkerLostError) -> str:
    """The end of a sentence on results of a lost worker."""
    return f"are left out: their worker was lost ({error})."
