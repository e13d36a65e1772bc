"""The best known optimum of each problem in conf/problem, and the evidence for it.

python -m experiments.check.optima [PROBLEM ...] [--starts 1000]

A problem that is linear in its parameters has a closed form. Otherwise, SciPy's bounded
trust-region solver descends from uniform starting points with a coarse tolerance, and continues
with a fine one if the coarse end is close to the best. The simplex of Nelder and Mead continues
from the ten best ends; it needs no derivatives and so passes kinks at which the solver stops. Exits
with 1 if a recorded optimum is beaten by more than 1e-9 or missed by more than 1e-7 (relative).
"""

import argparse
import math
import multiprocessing
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
import scipy.optimize
from tqdm import tqdm

from experiments.app.build import build
from experiments.app.compose import composed
from experiments.app.console import run_and_exit
from experiments.app.options import options_of
from miho.identification import CurveFit, linear_optimum
from miho.methods.unit_box import UnitBox
from miho.optim.seeds import stream
from miho.quantities import Array
from miho.study import single_thread

WORKERS = 2
ROUGH, FINE = 1e-6, 1e-12
"""Tolerances of the solver; the fine one is far below the tolerance for agreement."""
NEAR = 1e-2
"""Relative difference to the best rough end up to which a descent is taken to its end."""
NEAR_EXACT = 1e6
"""The same for data without errors, as a multiple of their resolution: rough ends differ widely."""
STEPS = 100
"""Largest number of evaluations of a descent; a longer one is on a plateau."""
POLISHED = 10
SIMPLEX = 4000
"""Evaluations of one simplex, which is started twice because a new simplex often gains more."""
SAME_MINIMUM = 1e-9
"""Largest relative difference of errors in one minimum; a larger gain beats a recorded optimum."""
APART = 1e-6
"""Smallest relative difference of errors in two minima."""
MISSED = 1e-7


@dataclass(frozen=True)
class Optimum:
    """The best known optimum of one problem, with errors in the unit of the output.

    `agreeing` of the descents from `starts` starting points end in the optimum; at `failed`
    starting points the model or its derivatives are not finite. `polished` of the ten simplices end
    in the optimum. `second` is the next local minimum, or NaN. Errors below the `resolution` of
    exact data are one optimum.
    """

    name: str
    dimension: int
    rows: int
    error: float
    theta: Array
    starts: int
    agreeing: int
    failed: int
    polished: int
    second: float
    seconds: float
    resolution: float = 0.0

    @property
    def evidence(self) -> str:
        """One sentence for the problem's file or row."""
        if not self.starts:
            return "closed form (linear least squares)"
        alike = "end below the resolution" if self.error < self.resolution else "agree to 1e-9"
        text = f"{self.agreeing} of {self.starts:,} uniform least-squares starts {alike}"
        if self.failed:
            text += f" (the model fails at {self.failed} of them)"
        if self.polished == POLISHED and self.agreeing:
            return f"{text}, and so do simplices from the ten best; none better"
        return f"{text}, and {self.polished} of ten simplices from the best; none better"


@cache
def problem_of(name: str) -> CurveFit:
    """Problem of a name in conf/problem."""
    return build(composed([f"problem={name}"])).problem


def starts_of(name: str, starts: int) -> Array:
    """Uniform starting points in the unit box (starts, d), the same in every process."""
    return stream("optima", name).random((starts, len(problem_of(name).space)))


def least_squares_end(name: str, tolerance: float, point: Array) -> tuple[Array, float]:
    """End of least squares from a point (d,), and its error.

    The error is NaN if the model fails at the starting point, or its derivatives fail later.
    """
    problem = problem_of(name)
    box = UnitBox(problem.space)

    def residuals(point: Array) -> Array:
        return problem.residuals(box.theta(point))

    def jacobian(point: Array) -> Array:
        theta = box.theta(point)
        return np.asarray(problem.jacobian(theta) * box.slope(theta))

    with single_thread():
        if not np.isfinite(residuals(point)).all():
            return point, math.nan
        try:
            descent = scipy.optimize.least_squares(
                residuals, point, jac=jacobian, bounds=(0.0, 1.0), method="trf", x_scale="jac",
                ftol=tolerance, xtol=tolerance, gtol=None, max_nfev=STEPS,
            )  # fmt: skip
        except (ValueError, np.linalg.LinAlgError):  # derivatives that are not finite
            return point, math.nan
        return descent.x, error_at(problem, descent.x)


def simplex_end(name: str, point: Array) -> tuple[Array, float]:
    """End of the simplex from a point (d,), and its error."""
    problem = problem_of(name)

    def error(point: Array) -> float:
        return error_at(problem, point)

    end = np.clip(point, 0.0, 1.0)
    with single_thread():
        for _ in range(2):
            end = scipy.optimize.minimize(
                error, end, method="Nelder-Mead", bounds=[(0.0, 1.0)] * point.size,
                options={"maxfev": SIMPLEX, "xatol": 1e-13, "fatol": 0.0, "adaptive": True},
            ).x  # fmt: skip
        return end, error(end)


def all_ends(
    pool: ProcessPoolExecutor, end: Callable[[Array], tuple[Array, float]], points: Array, name: str
) -> tuple[Array, Array]:
    """Ends (n, d) from points (n, d), and errors (n,), by all workers."""
    ends = pool.map(end, points, chunksize=max(1, len(points) // (10 * WORKERS)))
    bar = tqdm(ends, desc=name, total=len(points), leave=False, disable=None)
    places, errors = zip(*bar, strict=True)
    return np.array(places), np.array(errors)


def error_at(problem: CurveFit, point: Array) -> float:
    """Root of the loss at a point (d,) of the unit box; infinite if the model fails."""
    loss = float(problem.loss(UnitBox(problem.space).theta(point)[None])[0])
    return math.sqrt(loss) if math.isfinite(loss) else math.inf


def optimum_of(name: str, starts: int, pool: ProcessPoolExecutor) -> Optimum:
    """The best known optimum of one problem."""
    began = time.perf_counter()
    problem = problem_of(name)
    shape = (name, len(problem.space), len(problem.dataset))
    exact = linear_optimum(problem)
    if exact is not None:
        theta, loss = exact
        seconds = time.perf_counter() - began
        return Optimum(*shape, math.sqrt(loss), theta, 0, 0, 0, 0, math.nan, seconds)
    rough, fine = (partial(least_squares_end, name, tolerance) for tolerance in (ROUGH, FINE))
    ends, errors = all_ends(pool, rough, starts_of(name, starts), name)
    resolution = composed([f"problem={name}"]).problem.resolution or 0.0
    limit = max(np.nanmin(errors) * (1 + NEAR), NEAR_EXACT * resolution)
    near = np.flatnonzero(errors <= limit)
    ends[near], errors[near] = all_ends(pool, fine, ends[near], name)
    best = np.argsort(errors, kind="stable")[:POLISHED]
    finer, finest = all_ends(pool, partial(simplex_end, name), ends[best], name)
    points, all_errors = np.vstack([finer, ends[best]]), np.concatenate([finest, errors[best]])
    error = float(all_errors.min())
    least = max(error, resolution)
    other_minima = errors[errors > least * (1 + APART)]
    return Optimum(
        *shape,
        error=error,
        theta=UnitBox(problem.space).theta(points[all_errors.argmin()]),
        starts=starts,
        agreeing=int(np.count_nonzero(errors <= least * (1 + SAME_MINIMUM))),
        failed=int(np.count_nonzero(np.isnan(errors))),
        polished=int(np.count_nonzero(finest <= least * (1 + SAME_MINIMUM))),
        second=float(other_minima.min()) if other_minima.size else math.nan,
        seconds=time.perf_counter() - began,
        resolution=resolution,
    )


def verdict(optimum: Optimum, recorded: float | None) -> str:
    """Difference between an optimum and the recorded error in words; empty if they agree.

    Errors below the resolution are equal.
    """
    if recorded is None:
        return "not recorded"
    if max(optimum.error, recorded) <= optimum.resolution:
        return ""
    if optimum.error < recorded * (1 - SAME_MINIMUM):
        return f"beats the recorded {recorded:.12g}"
    if optimum.error > recorded * (1 + MISSED):
        return f"misses the recorded {recorded:.12g}"
    return ""


def main() -> None:
    """Find the optima, print them and compare them with the recorded ones."""
    names = options_of("problem")
    parser = argparse.ArgumentParser(description="Best known optima of the problems.")
    parser.add_argument("problems", nargs="*", metavar="PROBLEM", help=", ".join(names))
    parser.add_argument("--starts", type=int, default=1000)
    arguments = parser.parse_args()
    unknown = [name for name in arguments.problems if name not in names]
    if unknown:
        parser.error(f"unknown problem {unknown[0]}; choose from {', '.join(names)}")
    if arguments.starts < POLISHED:
        parser.error(f"--starts is {arguments.starts}; expected at least {POLISHED}")
    print(
        f"{'problem':<19}{'dim':>4}{'rows':>6}  {'optimum':<20}{'agree':>12}{'simplices':>11}"
        f"{'second':>14}{'seconds':>9}"
    )
    failed = False
    # A line for each problem, and below it the evidence, and which parameters are at a bound.
    with ProcessPoolExecutor(WORKERS, multiprocessing.get_context("spawn")) as pool:
        for name in arguments.problems or names:
            optimum = optimum_of(name, arguments.starts, pool)
            recorded = composed([f"problem={name}"]).problem.optimum
            remark = verdict(optimum, recorded)
            failed = failed or (recorded is not None and bool(remark))
            agree = f"{optimum.agreeing}/{optimum.starts}" if optimum.starts else "closed form"
            print(
                f"{name:<19}{optimum.dimension:>4}{optimum.rows:>6}  "
                f"{optimum.error:<20.14g}{agree:>12}"
                f"{optimum.polished if optimum.starts else '-':>11}{optimum.second:>14.7g}"
                f"{optimum.seconds:>9.1f}  {remark}",
                flush=True,
            )
            low, high = problem_of(name).space.low, problem_of(name).space.high
            share = (optimum.theta - low) / (high - low)
            at_bound = np.flatnonzero((share < 1e-6) | (share > 1 - 1e-6))
            bounds = ", ".join(problem_of(name).space.names[i] for i in at_bound)
            print(f"    {optimum.evidence}{f'; at a bound: {bounds}' if bounds else ''}")
    sys.exit(int(failed))


if __name__ == "__main__":
    run_and_exit(main)
