"""One method under two names: correct statistics must not find a difference.

python -m experiments.check.aa [METHOD]

Runs the method (default pso_constriction) 20 times on each problem of the arena, on two cores in
about four minutes. Runs with even and odd seeds are named A and B. Exits with 1 if Wilcoxon's test
over problems separates them at p < 0.05, or if the interval of their speed ratio excludes 1.

Seeds are fixed, so the result is always the same. The check finds gross faults of the statistics.
It does not test their level of 5 %, which would need many such pairs.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from experiments.app.comparing import plan_arena
from experiments.app.compose import composed
from experiments.app.configured import as_configured
from experiments.app.console import run_and_exit
from experiments.app.runs import run
from experiments.app.schema import SweepConfig, register
from miho.analysis.compare.leaderboard import families, family_scores, leaderboard, problem_scores
from miho.analysis.compare.profiles import area_over_curve
from miho.analysis.compare.running_time import NEAR_BEST, hits, running_times
from miho.analysis.compare.significance import pairwise, pairwise_speed_up
from miho.analysis.text import to_markdown
from miho.study import load_runs

REPETITIONS, EVALUATIONS, LEVEL = 20, 10_000, 0.05
METHOD = "pso_constriction"


def main() -> None:
    """Run, rename and test."""
    register()
    method = sys.argv[1] if len(sys.argv) > 1 else METHOD
    with tempfile.TemporaryDirectory() as root:
        overrides = ["experiment=arena", f"root={root}", f"budget.evaluations={EVALUATIONS}"]
        cfg = composed(overrides)
        cfg.comparison.repetitions = REPETITIONS
        cfg.comparison.methods = {method: {}}
        run(plan_arena(cfg, overrides, methods=1).plan, SweepConfig(workers=2)).raise_if_stopped()
        stored = load_runs(Path(root))
        runs, curves = as_configured(stored.runs), stored.curves
    for frame in (runs, curves):
        frame["optimizer"] = np.where(frame["seed"] % 2, "B", "A")
        frame["seed"] //= 2
    reached = hits(runs, curves, (NEAR_BEST,))
    ert, areas = running_times(reached, "evaluations"), area_over_curve(runs, curves)
    scores, kinds = problem_scores(ert, areas, NEAR_BEST), families(runs)
    test, strict = (pairwise(table).iloc[0] for table in (scores, family_scores(scores, kinds)))
    rng = np.random.default_rng(0)
    ratio = pairwise_speed_up(reached, NEAR_BEST, "evaluations", rng, families=kinds).iloc[0]
    print(to_markdown(leaderboard(runs, curves)))
    print(
        f"{method} against itself on {len(scores)} problems, {REPETITIONS // 2} runs on each: "
        f"Wilcoxon p = {test.p:.3f}, over families {strict.p:.3f}; {ratio.method} is "
        f"{ratio.ratio:.3f} times as fast as {ratio.rival}, 95 % interval "
        f"{ratio.low:.3f} to {ratio.high:.3f}"
    )
    if not ratio.problems:
        print(f"missed: {method} solves no problem, so that its speed cannot be compared")
        sys.exit(1)
    if test.p < LEVEL or not ratio.low <= 1 <= ratio.high:
        print("missed: a difference was found where there is none")
        sys.exit(1)


if __name__ == "__main__":
    run_and_exit(main)
