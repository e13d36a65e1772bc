"""Milliseconds to within 1 % of a tire's optimum, over the rows of its data.

python -m experiments.benchmarks.arrival [--quick] [--output FOLDER]

The methods alternate, seed by seed; figures are medians over seeds. `one look` is the loss of one
configuration on all rows: every run needs at least one, because it records that the target is
reached. The last column is the share of the model's values in the time of `miho_gn`.
"""

from functools import partial

import numpy as np
import pandas as pd

from experiments.app.build import build_optimizer, build_problem
from experiments.app.compose import composed
from experiments.benchmarks.bars import Measured, at_most, benchmark, interleaved
from miho.analysis.compare.running_time import NEAR_BEST
from miho.optim import MIHOGN, Budget, minimize

ROWS = (3000, 30_000, 300_000, 3_000_000)
SEEDS = {3000: 20, 30_000: 20, 300_000: 10, 3_000_000: 5}
METHODS = ("miho_gn", "miho_qn", "least_squares")
RIVALS = 30_000
"""Largest number of rows for the other methods; with more, a run that fails takes minutes."""
LOOK = "one look"


def measure(quick: bool) -> Measured:
    """Milliseconds of a run that ends at 1.01 times the optimum, by method and rows."""
    methods = {name: build_optimizer(composed([f"optimizer={name}"])) for name in METHODS}
    tidy = []
    for rows in ROWS[:2] if quick else ROWS:
        problem = build_problem(composed(["dataset=tire_lf", f"dataset.n={rows}"]))
        optimum = minimize(MIHOGN(), problem, Budget(evaluations=10_000))
        if optimum.theta is None:
            raise RuntimeError("the search for the optimum evaluated no valid configuration")
        target = NEAR_BEST**2 * optimum.loss
        budget = Budget(evaluations=40_000, target=target)
        at = optimum.theta[None]
        look = interleaved({LOOK: partial(problem.loss, at)}, 10)[LOOK]
        tidy.append({"rows": rows, "method": LOOK, "seed": 0, "ms": 1e3 * look, "evaluations": 1.0})
        seeds = range(SEEDS[rows] // (4 if quick else 1))
        print(f"{rows:,} rows, {len(seeds)} seeds", flush=True)
        for seed in seeds:
            for name, method in methods.items():
                if rows > RIVALS and name != METHODS[0]:
                    continue
                run = minimize(method, problem, budget, seed)
                arrived = run.loss <= target
                tidy.append(
                    {"rows": rows, "method": name, "seed": seed, "evaluations": run.evaluations,
                     "ms": 1e3 * run.seconds if arrived else np.inf}
                )  # fmt: skip
    frame = pd.DataFrame(tidy)
    median = frame.groupby(["rows", "method"])[["ms", "evaluations"]].median().unstack("method")
    ms, evaluations = median["ms"], median["evaluations"]
    table = ms[[LOOK, *METHODS]].add_suffix(" [ms]")
    table["miho_gn: evaluations"] = evaluations["miho_gn"]
    table["of its time, model values [%]"] = 100 * ms[LOOK] * evaluations["miho_gn"] / ms["miho_gn"]
    bars = [at_most("miho_gn at 3,000 rows", ms.loc[3000, "miho_gn"], 3.0, "ms")]
    notes = []
    if not quick:
        most, fewer = ms.loc[3_000_000], ms.loc[30_000]
        looks = most["miho_gn"] / most[LOOK]
        bars.append(at_most("miho_gn at 3,000,000 rows", looks, 1.5, "looks at all rows"))
        times = most["miho_gn"] / fewer["miho_gn"]
        notes.append(f"3,000,000 rows take {times:.3g} times as long as 30,000")
    return Measured(table.reset_index(), frame, bars, notes)


if __name__ == "__main__":
    benchmark(__doc__, measure, "arrival")
