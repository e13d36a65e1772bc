"""Runs and curves on several problems, from steps given as multiples of each problem's optimum."""

from __future__ import annotations

import numpy as np
import pandas as pd

from tests.analysis.synthetic import Steps, frames


def several(
    problems: dict[str, dict[str, list[Steps]]],
    *,
    optimum: dict[str, float] | None = None,
    ends: dict[str, float] | None = None,
    outcomes: dict[str, str] | None = None,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Both frames from (evaluations, error) steps: problem, method, one list of steps per seed.

    `optimum` holds the known best errors; the other problems have none.
    """
    runs, curves = [], []
    for problem, methods in problems.items():
        best_known = (optimum or {}).get(problem, np.nan)
        for frame, place in zip(
            frames(methods, ends=ends, outcomes=outcomes), (runs, curves), strict=True
        ):
            place.append(frame.assign(problem=problem, id=problem + "-" + frame["id"]))
        runs[-1]["optimum"] = best_known
    return pd.concat(runs, ignore_index=True), pd.concat(curves, ignore_index=True)


def random_runs(
    rng: np.random.Generator, *, problems: int = 3, methods: int = 3, seeds: int = 4
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Improving runs of 1000 evaluations from about 30 times an optimum of 10 down to near it."""
    steps_of: dict[str, dict[str, list[Steps]]] = {}
    for problem in range(problems):
        steps_of[f"p{problem}"] = {}
        for method in range(methods):
            repetitions = []
            for _ in range(seeds):
                at = np.append(1, np.sort(rng.choice(np.arange(2, 1000), 12, replace=False)))
                gap = np.sort(np.append(29, 10 ** rng.uniform(-4 + method / 2, 1, 12)))[::-1]
                repetitions.append(
                    [(float(a), float(10 * (1 + g))) for a, g in zip(at, gap, strict=True)]
                )
            steps_of[f"p{problem}"][f"m{method}"] = repetitions
    ends = {f"m{method}": 1000.0 for method in range(methods)}
    return several(steps_of, optimum=dict.fromkeys(steps_of, 10.0), ends=ends)
