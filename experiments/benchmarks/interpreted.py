"""Cost of an evaluation in each method of the paper's comparison, interpreted and as built here.

python -m experiments.benchmarks.interpreted [--quick] [--output FOLDER]

Interpreted: MIHO's mutations (Eq. 2), the particles of a swarm and the steps of gradient descent,
one at a time in a loop of Python, each loss of 3000 rows by NumPy. A step of descent counts as six
evaluations, as everywhere in this project. Compiled: the methods themselves, on the loss of all
rows. A figure is the least of several turns in which the methods alternate, because other work on
the machine makes single turns longer.
"""

import math
import time
from functools import partial

import numpy as np
import pandas as pd

from experiments.app.build import Experiment, build
from experiments.app.compose import composed
from experiments.benchmarks.bars import Measured, benchmark
from miho import MIHO, Budget, CurveFit, minimize
from miho.optim.seeds import stream
from miho.quantities import Array

TURNS, QUICK_TURNS = 15, 2
INTERPRETED, COMPILED = 1_200, 30_000
"""Evaluations per turn."""
SWARMS = {"pso_100": 100, "pso_500": 500}
METHODS = ("miho", "gbo_small", "gbo_large", *SWARMS)


def loss(theta: Array, alpha: Array, force: Array) -> float:
    """Mean square (Eq. 5) of the tire's force (Eq. 4) at slip angles (n,)."""
    B, C, D, Sx, Sy = theta
    residuals = D * np.sin(C * np.arctan(B * (Sx - alpha))) + Sy - force
    return float(np.mean(residuals**2))


def mutations(problem: CurveFit, evaluations: int) -> float:
    """Mutate one configuration repeatedly and return the least loss."""
    alpha, force, space, rng = *_data(problem), problem.space, stream("interpreted")
    sigma, p = space.sigma[0], space.initial(1)[0]
    best = loss(p, alpha, force)
    for _ in range(evaluations):
        mutant = np.clip(p + sigma * rng.standard_normal(p.size), space.low, space.high)
        value = loss(mutant, alpha, force)
        if value < best:
            p, best = mutant, value
    return best


def swarm(problem: CurveFit, evaluations: int, particles: int) -> float:
    """Move the particles of a swarm one after the other and return the least loss."""
    alpha, force, space, rng = *_data(problem), problem.space, stream("interpreted")
    x, limit = space.initial(particles), 0.5 * (space.high - space.low)
    v, best, leader = np.zeros_like(x), x.copy(), 0
    losses = np.full(particles, np.inf)
    for evaluation in range(evaluations):
        i = evaluation % particles
        value = loss(x[i], alpha, force)
        if value < losses[i]:
            best[i], losses[i] = x[i], value
            if value < losses[leader]:
                leader = i
        pull = 2 * rng.random(5) * (best[i] - x[i]) + 2 * rng.random(5) * (best[leader] - x[i])
        v[i] = np.clip(0.9 * v[i] + pull, -limit, limit)
        x[i] = np.clip(x[i] + v[i], space.low, space.high)
    return float(losses.min())


def descent(problem: CurveFit, evaluations: int) -> Array:
    """Parameters (5,) after steps along the gradient, by derivatives in closed form."""
    alpha, force, space = *_data(problem), problem.space
    theta = space.initial(1)[0]
    for _ in range(evaluations // 6):
        B, C, D, Sx, Sy = theta
        slip = Sx - alpha
        angle = np.arctan(B * slip)
        wave, slope = np.sin(C * angle), D * np.cos(C * angle)
        residuals = D * wave + Sy - force
        bent = slope * C / (1 + (B * slip) ** 2)
        J = np.array([bent * slip, slope * angle, wave, bent * B, np.ones_like(alpha)])
        gradient = 2 / alpha.size * (J @ residuals)
        theta = np.clip(theta - 1e-10 * gradient, space.low, space.high)
    return np.asarray(theta)


def measure(quick: bool) -> Measured:
    """Microseconds of the processor per evaluation of each method, interpreted and compiled."""
    built = {name: build(composed([f"optimizer={name}", "dataset=tire_lf"])) for name in METHODS}
    jobs = {(name, "interpreted"): partial(interpreted, name, built[name]) for name in METHODS}
    jobs |= {(name, "compiled"): partial(compiled, built[name]) for name in METHODS}
    least = dict.fromkeys(jobs, math.inf)
    for _ in range(QUICK_TURNS if quick else TURNS):
        for key, job in jobs.items():
            least[key] = min(least[key], job())
    columns = {
        kind: [1e6 * least[m, kind] for m in METHODS] for kind in ("interpreted", "compiled")
    }
    table = pd.DataFrame({"method": METHODS, **columns})
    return Measured(table, table, [], ["microseconds of the processor per evaluation"])


def interpreted(name: str, experiment: Experiment) -> float:
    """Seconds of the processor per evaluation of a loop in Python."""
    started = time.process_time()
    if name in SWARMS:
        swarm(experiment.problem, INTERPRETED, SWARMS[name])
    else:
        {"miho": mutations}.get(name, descent)(experiment.problem, INTERPRETED)
    return (time.process_time() - started) / INTERPRETED


def compiled(experiment: Experiment) -> float:
    """Seconds of the processor per evaluation of the method; MIHO runs its whole schedule."""
    whole = isinstance(experiment.optimizer, MIHO)
    budget = Budget(evaluations=None if whole else COMPILED)
    record = minimize(experiment.optimizer, experiment.problem, budget)
    return record.cpu_seconds / record.evaluations


def _data(problem: CurveFit) -> tuple[Array, Array]:
    """Slip angles [rad] and forces [N], (n,) each."""
    return problem.dataset["alpha"], problem.dataset[problem.dataset.output]


if __name__ == "__main__":
    benchmark(__doc__, measure, "interpreted")
