"""How often `miho_gn` claims an optimum that is not the best, on families of curves drawn by seed.

python -m experiments.check.false_ends --instances 50 --processes 2
python -m experiments.check.false_ends --instances 50 --families 'sine*' --set challenges=1

Each instance of a family has different true parameters, rows and noise. A run claims an optimum if
it ends by evidence. It is right if its loss is at most 0.2 % above the best known loss, from a
descent from the true parameters or from any run. `claims` counts right and wrong claims, `silent`
counts runs that are right without a claim. A `badly` wrong run has an error more than 6 % above the
best.
"""

import argparse
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from fnmatch import fnmatchcase
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from omegaconf import OmegaConf
from tqdm import tqdm

from experiments.benchmarks.bars import machine
from experiments.check.families import FAMILIES
from miho import MIHOGN, Budget, minimize
from miho.study import single_thread

RIGHT, BADLY = 2e-3, 0.06
"""Largest loss above the best one for a right run (the profile interval of one parameter reaches
3.84 in chi-squared, 2 % of it for 200 rows), and largest error above the best one that is not
badly wrong."""
BUDGET = Budget(evaluations=30_000)
Job = tuple[str, int, int, int, Mapping[str, Any]]


def run(job: Job) -> dict[str, object]:
    """Make a run, and return its row of the table of all runs.

    A job has a family, a draw, an instance, a seed, and settings of `MIHOGN`.
    """
    name, draw, instance, seed, settings = job
    family = FAMILIES[name]
    rng = np.random.default_rng([draw, list(FAMILIES).index(name), instance])
    fit, known = family.problem(rng)
    with single_thread():
        record = minimize(MIHOGN(**settings), fit, BUDGET, seed)
    return {
        "kind": family.kind, "family": name, "instance": instance, "seed": seed, "known": known,
        "loss": record.loss, "evaluations": record.evaluations,
        "claims": str(record.outcome) == "converged",
    }  # fmt: skip


def judged(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the runs with the columns `right`, `wrong`, `badly` and `silent`."""
    best = runs[["loss", "known"]].min(axis=1)
    best = best.groupby([runs["family"], runs["instance"]]).transform("min")
    right, badly = runs["loss"] <= (1 + RIGHT) * best, runs["loss"] > (1 + BADLY) ** 2 * best
    return runs.assign(
        right=right, wrong=runs["claims"] & ~right, badly=runs["claims"] & badly,
        silent=right & ~runs["claims"],
    )  # fmt: skip


def table(runs: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """Counts of runs by these columns, and the median of their evaluations."""
    counts = runs.groupby(keys, sort=False)[["right", "claims", "wrong", "badly", "silent"]].sum()
    groups = runs.groupby(keys, sort=False)["evaluations"]
    counts.insert(0, "runs", groups.size())
    return counts.assign(evaluations=groups.median().round().astype(int))


def main() -> None:
    """Draw problems, run the method, print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--families", default="*", help="names of families, with wildcards")
    parser.add_argument("--instances", type=int, default=8, help="problems per family (8)")
    parser.add_argument("--seeds", type=int, default=1, help="runs per problem (1)")
    parser.add_argument("--draw", type=int, default=0, help="seed of the problems (0)")
    parser.add_argument("--processes", type=int, default=1, help="simultaneous runs (1)")
    parser.add_argument(
        "--set", nargs="*", default=[], metavar="NAME=VALUE", help="settings of miho_gn"
    )
    arguments = parser.parse_args()
    names = [name for name in FAMILIES if fnmatchcase(name, arguments.families)]
    if not names:
        parser.error(f"--families {arguments.families}: none matches; families are "
                     + ", ".join(FAMILIES))  # fmt: skip
    try:
        settings = dict[str, Any](OmegaConf.from_dotlist(arguments.set))
        MIHOGN(**settings)
    except (TypeError, ValueError) as error:
        parser.error(f"--set: {error}")
    print(machine())
    jobs = [
        (name, arguments.draw, instance, seed, settings)
        for name, instance, seed in product(
            names, range(arguments.instances), range(arguments.seeds)
        )
    ]
    with ProcessPoolExecutor(arguments.processes) as pool:
        rows = list(tqdm(pool.map(run, jobs, chunksize=4), total=len(jobs), disable=None))
    runs = judged(pd.DataFrame(rows))
    for keys in (["kind", "family"], ["kind"]):
        print(table(runs, keys).to_string(), "\n")
    claims, wrong = int(runs["claims"].sum()), int(runs["wrong"].sum())
    print(f"{len(runs):,} runs, {claims:,} claims, {wrong:,} wrong ({wrong / max(claims, 1):.2%})")


if __name__ == "__main__":
    main()
