"""The steps from the result of a run to its report."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd

from miho.identification.alternatives import minima_at, optima_within_noise
from miho.identification.bootstrap import replicated
from miho.identification.conclusion import BOOTSTRAP, CHECK, PROFILE, conclusion_on, linear_optimum
from miho.identification.curve_fit import CurveFit
from miho.identification.deadline import Deadline, seconds_of_refit
from miho.identification.flags import REMEDY
from miho.identification.profile_likelihood import SIGNS, Profile, joined, profile_side
from miho.identification.refit import OutOfTimeError, Refit, refit
from miho.identification.report import Report, rounding_of
from miho.identification.stated import profiled_parameters, reported_space
from miho.identification.uncertainty import Linearised, linearised
from miho.identification.validation import conditions, leave_one_out, root_mean_square
from miho.optim import Descents, Minimum, in_optimum
from miho.parallel import Pool, Workers, open_pool
from miho.parallel.blocks import in_blocks
from miho.parallel.process_executor import WorkerLostError
from miho.quantities import Array
from miho.validate import whole

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
    if not isinstance(level, float | np.floating) or not 0 < level < 1:
        raise ValueError(f"level is {level!r}; expected a number between 0 and 1, for example 0.95")
    whole("replicates", replicates, 0)
    if replicates and problem.prior is not None:
        raise ValueError(
            f"replicates is {replicates}; expected 0 for a problem with priors, which resampled "
            "rows ignore; use profile intervals instead"
        )
    # The optimum comes first, because every other result describes it.
    deadline = Deadline(time.perf_counter() + seconds)
    progress("optimum")
    with open_pool(workers) as pool:
        steps = _Steps(problem, level, profiles, deadline, progress, pool, seconds)
        descent = steps.optimum(run if optimum is None else optimum)
        if optimum is not None and deadline.over and not descent.converged:
            # Without time for a new descent, the state of the earlier one counts.
            descent = descent._replace(converged=not moving, evaluations=moving)
        best = _Best(descent, found_by)
        if better is not None:
            best = steps.better_of(best, steps.optimum(better), CHECK)
        searches = tuple(search for search in (descents, check) if search is not None)
        minima = [*minima, *Descents.together(searches).minima]
        while True:
            best, optima, curves, omitted = steps.profiled(best, minima)
            at = optima[0]
            # Fits without some rows, and the bootstrap, use the time that is left.
            left_out, unfinished = steps.left_out(at)
            estimates = None
            if replicates:
                estimates = replicated(problem, optima, replicates, seed, progress, pool)
            earlier, best = best, steps.best_of_replicates(best, estimates)
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


class _Best(NamedTuple):
    """The best optimum so far, and the step that found it if the search did not."""

    descent: Refit
    found_by: str = ""


@dataclass(frozen=True)
class _Steps:
    """The steps of a report on a problem: its optimum, uncertainties, profiles and validation.

    `requested` says whether profiles were requested; `seconds` is the time until the deadline.
    """

    problem: CurveFit
    level: float
    requested: bool | None
    deadline: Deadline
    progress: Callable[[str], object]
    pool: Pool | None
    seconds: float

    def optimum(self, start: Array) -> Refit:
        """The optimum near `start` (d,), or the point that the descent reached in time.

        Parameters without an effect at the start are fixed, so they keep the value of the run.
        """
        problem = self.problem
        derivatives = problem.jacobian(problem.space.clip(start))
        ineffective = np.flatnonzero(~derivatives.any(axis=0)).tolist()
        return refit(
            problem, start, fixed=ineffective, evaluations=EVALUATIONS, deadline=self.deadline
        )

    def better_of(self, best: _Best, other: Refit, found_by: str) -> _Best:
        """The better of the two; `best` if both are the same optimum."""
        rounding = self.problem.resolution * self.problem.residual_count
        same = in_optimum(other.cost, best.descent.cost, rounding)
        return best if same else _Best(other, found_by)

    def profiled(
        self, best: _Best, minima: Sequence[Minimum]
    ) -> tuple[_Best, tuple[Linearised, ...], dict[str, Profile], list[str]]:
        """The best optimum, uncertainties of all optima within the noise, profiles, and remarks.

        If a refit of a profile finds a better optimum, everything is computed again from there.
        """
        problem = self.problem
        while True:
            within = optima_within_noise(problem, best.descent, minima, self.level, self.deadline)
            optima = tuple(self.uncertainty(fit.theta) for fit in within)
            best = best._replace(descent=within[0])
            curves, omitted = self.profiles(optima)
            refits = (curve.best for curve in curves.values())
            lowest = min(refits, key=lambda fit: fit.cost, default=best.descent)
            if self.better_of(best, lowest, PROFILE) is best:
                return best, optima, curves, omitted
            self.progress("better optimum")
            minima = [*minima_at(problem, optima), *minima]
            best = _Best(self.optimum(lowest.theta), PROFILE)

    def best_of_replicates(self, best: _Best, estimates: Array | None) -> _Best:
        """The best optimum so far, or a better one near the best of the replicates (n, d).

        A replicate is the optimum of resampled data and may lie in a lower basin of the data.
        """
        if estimates is None:
            return best
        losses = np.nan_to_num(self.problem.loss(estimates), nan=np.inf)
        if best.descent.cost <= losses.min() * self.problem.residual_count:
            return best
        return self.better_of(best, self.optimum(estimates[np.argmin(losses)]), BOOTSTRAP)

    def left_out(self, at: Linearised) -> tuple[pd.DataFrame, list[str]]:
        """Errors on groups of rows, each from a fit without the group, and remarks."""
        tables, omitted = [pd.DataFrame()], list[str]()
        held = np.flatnonzero(at.unidentifiable).tolist()
        for name in conditions(self.problem):
            self.progress(f"leave one {name} out")
            try:
                tables.append(
                    leave_one_out(self.problem, at.theta, name, held, self.deadline, self.pool)
                )
            except OutOfTimeError:
                omitted.append(f"errors with {name} {self.too_late}")
                break
            except WorkerLostError as error:
                omitted.append(f"errors with {name} {_lost(error)}")
        return pd.concat(tables[1:] or tables, ignore_index=True), omitted

    def uncertainty(self, theta: Array) -> Linearised:
        """The uncertainty of an optimum (d,), allowing for correlated neighbouring rows.

        Rounding errors may be correlated too, so the correlation is ignored if all errors are
        rounding.
        """
        error = root_mean_square(self.problem.errors(theta))
        return linearised(self.problem, theta, neighbours=error > rounding_of(self.problem))

    def profiles(self, optima: Sequence[Linearised]) -> tuple[dict[str, Profile], list[str]]:
        """The profiles by parameter, and remarks on missing ones.

        Parameters that are at a bound or unidentifiable at all optima have no profile. There are no
        profiles for data in events, or if the errors are rounding.
        """
        at, requested = optima[0], self.requested
        if requested is None:
            requested = len(self.problem.space) <= MOST_PROFILES
        if not requested or at.events or at.noise <= rounding_of(self.problem):
            return {}, []
        parameters: dict[str, int | str] = {}
        for optimum in optima:
            parameters |= profiled_parameters(self.problem, optimum)
        limit = Deadline() if self.requested else self.deadline
        # Each side of each profile is one task.
        sides = in_blocks(
            self.pool,
            partial(profile_side, self.problem, optima, self.level, limit),
            [(of, sign) for of in parameters.values() for sign in SIGNS],
            None if self.pool is None else REFITS * seconds_of_refit(self.problem, at.theta),
            limit.check,
        )
        curves: dict[str, Profile] = {}
        late: list[str] = []
        omitted: list[str] = []
        for name in parameters:
            self.progress(f"profile of {name}")
            try:
                lower, upper = (next(sides, None) for _ in SIGNS)
            except OutOfTimeError:  # which ends `sides`
                lower = upper = None
            lost = [side for side in (lower, upper) if isinstance(side, WorkerLostError)]
            if lost:
                omitted.append(f"profile intervals of {name} {_lost(lost[0])}")
            elif lower is None or upper is None:
                late.append(name)
            else:
                curves[name] = joined(lower, upper)
        if late:
            omitted.append(f"profile intervals of {', '.join(late)} {self.too_late}")
        return curves, omitted

    @property
    def too_late(self) -> str:
        """The end of a sentence on results that the time limit excluded."""
        longer = f"{10 * self.seconds:g}"
        return (
            f"are left out: the time limit of {self.seconds:g} s is over; set seconds={longer}, or "
            f"--seconds {longer} on the command line."
        )


def _lost(error: WorkerLostError) -> str:
    """The end of a sentence on results of a lost worker."""
    return f"are left out: their worker was lost ({error})."
