"""From the parameters that a run ended with to their report, step by step."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from miho.identification.bootstrap import block_length, bootstrap, stretched
from miho.identification.closed_form import linear_optimum
from miho.identification.curve_fit import CurveFit
from miho.identification.flags import lost_effect
from miho.identification.profile_likelihood import (
    SIGNS,
    Profile,
    ProfileSide,
    joined,
    likelihood_profile,
)
from miho.identification.refit import (
    Deadline,
    OutOfTimeError,
    Refit,
    refit,
    seconds_of_refit,
)
from miho.identification.report import REMEDY, Report, irreducible_of, rounding_of
from miho.identification.standing import Standing, standing
from miho.identification.stated import (
    reported_space,
    reported_uncertainty,
    tied_names,
    tied_slopes,
)
from miho.identification.uncertainty import Linearised, linearised
from miho.identification.validation import conditions, leave_one_out, root_mean_square
from miho.optim import Descents
from miho.optim.seeds import stream
from miho.parallel import Pool, Workers, open_pool
from miho.parallel.blocks import in_blocks
from miho.parallel.process_executor import WorkerLostError
from miho.quantities import Array

MOST_PROFILES = 10
"""Models with more parameters are profiled only if asked: each end costs several refits."""
EVALUATIONS = 5000
"""Evaluations at most of the descent to the optimum that the report is of."""
REFITS = 4
"""Refits that a side of a profile takes at least."""
TRIALS = 10
"""Configurations at which a parameter without effect is tried again."""
BETTER = 1e-4
"""A sum of squares that is smaller by this fraction is another, better optimum."""
SECONDS = 60.0
"""Time limit, by default, of all that a report computes without being asked for it."""


def make_report(
    problem: CurveFit,
    run: Array,
    *,
    descents: Descents | None = None,
    check: Descents | None = None,
    better: Array | None = None,
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
    """The report on the optimum near `run` (d,), the parameters that a run of a problem ended with.

    `descents` says where those of the run ended, `check` those of a check, and the report is of the
    optimum near its result `better` (d,) if that is better; `best_known` is the loss
    of a recorded optimum. `replicates` bootstrap estimates (1000 for an interval, 0 for none),
    drawn from `seed`, in blocks where rows depend on their neighbours; `profiles` by default for
    models of up to MOST_PROFILES parameters, none for data in events. What is computed by default
    ends after `seconds`; `Report.omitted` lists what is missing then. What is asked for
    (replicates, profiles) takes the time it takes. `progress` is called before each of many steps
    with the name of the stage. `workers`, those of `miho.fit`, share profiles, replicates and
    refits without some rows where these take long; the report is the same. Raises ValueError where
    there is no uncertainty to be had: fewer rows than parameters, or derivatives not finite.
    """
    if not 0 < level < 1:
        raise ValueError(f"level is {level!r}; expected between 0 and 1, such as 0.95")
    if replicates and problem.prior is not None:
        raise ValueError(
            f"replicates is {replicates}: rows drawn anew say nothing of priors; leave the "
            "bootstrap out, profile intervals allow for them"
        )
    # The optimum first: profiles may find a better one, and all else is said of it.
    deadline = Deadline(time.perf_counter() + seconds)
    progress("optimum")
    optimum = _optimum(problem, run, deadline)
    if better is not None:
        optimum = min(optimum, _optimum(problem, better, deadline), key=lambda fit: fit.cost)
    with open_pool(workers) as pool:
        work = _Work(deadline, progress, pool, _omission(seconds))
        optimum, at, curves, omitted = _profiled(problem, optimum, level, profiles, work)
        # What time was left for besides.
        left_out, unfinished = _left_out(problem, at, work)
        estimates = _bootstrapped(problem, at, replicates, seed, work) if replicates else None
    reported = reported_space(problem.space).names
    searches = tuple(search for search in (descents, check) if search is not None)
    exact = linear_optimum(problem)
    best_known = best_known if exact is None else exact[1]
    return Report(
        problem=problem,
        run=run,
        at=at,
        standing=_standing(problem, at, optimum, searches, best_known, exact is not None),
        profiles=tuple(curves.get(name) for name in reported),
        tied_profiles={name: curve for name, curve in curves.items() if name not in reported},
        replicates=estimates,
        left_out=left_out,
        level=level,
        omitted=(*omitted, *unfinished),
        remedy=remedy,
        searches=searches,
        best_known=best_known,
    )


@dataclass(frozen=True)
class _Work:
    """Until when steps may go on, whom they tell of it, who does them, and why one is left out."""

    deadline: Deadline
    progress: Callable[[str], object]
    pool: Pool | None
    too_late: str


def _profiled(
    problem: CurveFit, optimum: Refit, level: float, requested: bool | None, work: _Work
) -> tuple[Refit, Linearised, dict[str, Profile], list[str]]:
    """The optimum, its uncertainty, and what `_profiles` gives.

    Where a refit for a profile meets a better optimum, all is again from there.
    """
    while True:
        at = _uncertainty(problem, optimum.theta)
        curves, omitted = _profiles(problem, at, level, requested, work)
        refits = (curve.best for curve in curves.values())
        lowest = min(refits, key=lambda fit: fit.cost, default=optimum)
        if lowest.cost >= (1 - BETTER) * optimum.cost:
            return optimum, at, curves, omitted
        work.progress("better optimum")
        optimum = _optimum(problem, lowest.theta, work.deadline)


def _held(at: Linearised) -> list[int]:
    """The parameters that no refit to other data moves: the data do not see them."""
    return np.flatnonzero(at.unidentifiable).tolist()


def _bootstrapped(
    problem: CurveFit, at: Linearised, replicates: int, seed: int, work: _Work
) -> Array:
    """Estimates (replicates, d) from rows drawn anew, in blocks where they depend on each other."""
    rng = stream("bootstrap", problem.dataset.digest, seed)
    block = 1 if at.dependence is None else block_length(at.dependence.errors)
    estimates = bootstrap(
        problem, at.theta, replicates, rng, lambda: work.progress("bootstrap"), _held(at), block,
        work.pool,
    )  # fmt: skip
    return estimates if at.dependence is None else stretched(estimates, at, problem.space)


def _left_out(problem: CurveFit, at: Linearised, work: _Work) -> tuple[pd.DataFrame, list[str]]:
    """Errors on each group of rows that a fit was made without, and what is missing and why."""
    tables: list[pd.DataFrame] = []
    omitted: list[str] = []
    for condition in conditions(problem):
        work.progress(f"leave one {condition} out")
        try:
            tables.append(
                leave_one_out(problem, at.theta, condition, _held(at), work.deadline, work.pool)
            )
        except OutOfTimeError:
            return _stacked(tables), [*omitted, f"errors with {condition} {work.too_late}"]
        except WorkerLostError as error:
            omitted.append(f"errors with {condition} {_lost(error)}")
    return _stacked(tables), omitted


def _stacked(tables: list[pd.DataFrame]) -> pd.DataFrame:
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def _uncertainty(problem: CurveFit, theta: Array) -> Linearised:
    """That of the optimum (d,), for rows that may depend on their neighbours.

    Errors that are rounding are as alike as the rounding is, which tells nothing.
    """
    neighbours = root_mean_square(problem.errors(theta)) > rounding_of(problem)
    return linearised(problem, theta, neighbours)


def _profiles(
    problem: CurveFit,
    at: Linearised,
    level: float,
    requested: bool | None,
    work: _Work,
) -> tuple[dict[str, Profile], list[str]]:
    """The profiles that there are by parameter, and a sentence on those that are missing.

    Of a parameter at its bound, or not identifiable, there is none; nor where rows are not
    independent, which a profile takes them for, or where the errors are rounding.
    """
    curves: dict[str, Profile] = {}
    by_default = len(problem.space) <= MOST_PROFILES
    if at.events or at.noise <= rounding_of(problem):
        return curves, []
    possible = _profiled_parameters(problem, at)
    names = list(possible) if (by_default if requested is None else requested) else []
    limit = None if requested else work.deadline
    if work.pool is not None:
        return _profiles_by_workers(
            problem, at, level, {n: possible[n] for n in names}, limit, work
        )
    for done, name in enumerate(names):
        work.progress(f"profile of {name}")
        try:
            curves[name] = likelihood_profile(problem, at, possible[name], level, limit)
        except OutOfTimeError:
            late = ", ".join(names[done:])
            return curves, [f"profile intervals of {late} {work.too_late}"]
    return curves, []


def _profiles_by_workers(
    problem: CurveFit,
    at: Linearised,
    level: float,
    parameters: Mapping[str, int | str],
    limit: Deadline | None,
    work: _Work,
) -> tuple[dict[str, Profile], list[str]]:
    """The same, each side of each profile by itself."""
    check = (lambda: None) if limit is None else limit.check
    sides = in_blocks(
        work.pool,
        ProfileSide(problem, at, level, limit),
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


def _profiled_parameters(problem: CurveFit, at: Linearised) -> dict[str, int | str]:
    """The parameters that have a finite standard error, then the tied ones: position, or name."""
    free, reported = problem.space.names, reported_space(problem.space).names
    errors = reported_uncertainty(problem, at).standard_errors
    usable = np.flatnonzero(np.isfinite(errors) & (errors > 0)).tolist()
    places: dict[str, int | str] = {
        reported[k]: k if reported[k] == free[k] else reported[k] for k in usable
    }
    tied = tied_names(problem)
    if tied:
        spread = at.independent.spread(tied_slopes(problem, at.theta, tied))
        places |= {n: n for n, e in zip(tied, spread, strict=True) if 0 < e < np.inf}
    return places


def _optimum(problem: CurveFit, start: Array, deadline: Deadline) -> Refit:
    """The optimum near `start` (d,), or how far the deadline let the descent come.

    Parameters without effect at the start are held, so that they keep the run's value.
    """
    derivatives = problem.jacobian(problem.space.clip(start))
    ineffective = np.flatnonzero(~derivatives.any(axis=0)).tolist()
    return refit(problem, start, fixed=ineffective, evaluations=EVALUATIONS, deadline=deadline)


def _standing(
    problem: CurveFit,
    at: Linearised,
    optimum: Refit,
    searches: Sequence[Descents],
    best_known: float | None,
    linear: bool,
) -> Standing:
    """The standing of the optimum that the report is of; `linear`: the best known is exact."""
    stand = standing(
        optimum.cost / problem.residual_count,
        problem.resolution,
        searches,
        best_known=best_known,
        irreducible=irreducible_of(problem),
        error=root_mean_square(problem.errors(at.theta)),
    )
    if not optimum.converged and not linear:
        moving = (
            f"a descent from it was still moving after {optimum.evaluations:,} evaluations, so "
            "standard errors and intervals are not those of an optimum"
        )
        return Standing(stand.evidence, _joined(stand.doubt, moving))
    if at.unidentifiable.any():
        lost = lost_effect(at, problem.space, _never_identifiable(problem))
        return Standing(stand.evidence, _joined(stand.doubt, lost), certain=stand.certain)
    return stand


def _joined(*reasons: str) -> str:
    return "; ".join(filter(None, reasons))


def _never_identifiable(problem: CurveFit) -> NDArray[np.bool_]:
    """Which parameters (d,) are unidentifiable at all of some configurations across the box.

    The rank of the derivatives is the same almost everywhere for a smooth model, so such a
    parameter cannot be identified from these inputs.
    """
    never = np.ones(len(problem.space), dtype=bool)
    for theta in problem.space.decode(problem.space.initial(TRIALS)):
        with contextlib.suppress(ValueError):
            never &= linearised(problem, theta).unidentifiable
    return never


def _omission(seconds: float) -> str:
    """The end of a sentence on results that there was no time for."""
    return (
        f"are left out: there were {seconds:g} s for such refits (--seconds {10 * seconds:g} gives "
        "more)."
    )


def _lost(error: WorkerLostError) -> str:
    """The end of a sentence on results that a worker did not come to."""
    return f"are left out: their worker was lost ({error})."
