"""Whether advised rows narrow an interval more than random rows, by simulation on the tire.

python -m experiments.check.next_measurement [--choices 100 --replicates 400]   # some minutes

The present data are 100 slip angles within 0.15 rad on the tire of `experiments.check.coverage`.
The candidates are 601 angles within 0.3 rad, of which 40 can be measured. For the advised rows and
for random choices of 40 rows, datasets with new noise on all rows are fitted. The criterion is the
spread of these estimates, which does not rely on linearisation.
"""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from tqdm import tqdm

from experiments.check import arguments
from experiments.check.coverage import NOISE, TRUTH, tire_fit
from miho.identification import CurveFit, make_report, optimal_design
from miho.identification.refit import refit
from miho.optim.seeds import stream
from miho.quantities import Array

PRESENT = np.linspace(-0.15, 0.15, 100)
CANDIDATES = np.linspace(-0.3, 0.3, 601)
SIZE = 40
STIFFNESS = "cornering stiffness B C D (Eq. 14)"
ALL = "all parameters"
GOALS = (ALL, "B", "C", "D", STIFFNESS)


def synthetic(alpha: Array, rng: np.random.Generator) -> CurveFit:
    """Fit to the tire at these slip angles [rad], with noise."""
    return tire_fit("tire", alpha, NOISE * rng.standard_normal(alpha.size))


def advised() -> Mapping[str, Array]:
    """Advised slip angles [rad] for each goal after a first fit."""
    problem = synthetic(PRESENT, stream("next measurement", "present"))
    report = make_report(problem, TRUTH, profiles=False)
    designs = {
        goal: optimal_design(
            report, {"alpha": CANDIDATES}, SIZE, goal=None if goal == ALL else goal
        )
        for goal in GOALS
    }
    return {goal: design.chosen["alpha"].to_numpy() for goal, design in designs.items()}


def spreads(more: Array, replicates: int, *key: str | int) -> dict[str, float]:
    """Standard deviation of the estimates of each goal, from the present rows and `more` of them.

    For all parameters, it is the geometric mean over the principal axes of their covariance in
    units of the true parameters.
    """
    rng = stream("next measurement", *key)
    alpha = np.concatenate([PRESENT, more])
    thetas = np.array([refit(synthetic(alpha, rng), TRUTH).theta for _ in range(replicates)])
    B, C, D = thetas[:, :3].T
    volume = np.linalg.det(np.cov((thetas / np.abs(TRUTH)).T)) ** (1 / (2 * TRUTH.size))
    deviations = {"B": B, "C": C, "D": D, STIFFNESS: B * C * D}
    relative = {name: np.std(x, ddof=1) / abs(np.mean(x)) for name, x in deviations.items()}
    return {ALL: float(volume)} | {name: float(x) for name, x in relative.items()}


def compared(choices: int, replicates: int) -> pd.DataFrame:
    """One row per goal: spread in % of its value without more rows, for advised and random rows."""
    rows = {goal: spreads(alpha, replicates, goal)[goal] for goal, alpha in advised().items()}
    drawn = stream("next measurement", "choices")
    random = pd.DataFrame(
        spreads(drawn.choice(CANDIDATES, SIZE, replace=False), replicates, "random", number)
        for number in tqdm(range(choices), desc="random choices", disable=None)
    )
    table = pd.DataFrame(
        {
            "present": pd.Series(spreads(np.empty(0), replicates, "none")),
            "advised": pd.Series(rows),
            "best of random": random.min(),
            "median of random": random.median(),
        }
    )
    return (100 * table.loc[list(GOALS)]).rename_axis("goal").reset_index()


def main() -> None:
    """Print the spreads, and whether the advised rows are at least as good as the best."""
    options = arguments(__doc__, choices=100, replicates=400)
    table = compared(options.choices, options.replicates)
    error = 100 / np.sqrt(2 * options.replicates)
    print(f"Spread of estimates over {options.replicates} simulated data sets, in % of the value")
    print(f"(each known to {error:.1f} % of itself), with {SIZE} rows more:\n")
    print(table.to_string(index=False, float_format="%.2f"))
    better = table["advised"] <= table["best of random"]
    print(f"\nadvised rows at least as good as the best of {options.choices}: {better.sum()} "
          f"of {len(table)} goals")  # fmt: skip


if __name__ == "__main__":
    main()
