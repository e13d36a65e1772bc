"""Runs and curves with known answers, and a set that resembles the paper's Fig. 6."""

from __future__ import annotations

import numpy as np
import pandas as pd

SECONDS_PER_EVALUATION = 1e-4
Steps = list[tuple[float, float]]


def frames(
    runs: dict[str, list[Steps]],
    *,
    ends: dict[str, float] | None = None,
    outcomes: dict[str, str] | None = None,
    unit: str = "N",
    irreducible: tuple[float, float] = (float("nan"), float("nan")),
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Both frames from (evaluations, error in N) steps: one list of steps per method and seed.

    Seconds are evaluations times SECONDS_PER_EVALUATION. Runs end by budget after 1e6
    evaluations unless `ends` and `outcomes` say otherwise. A run without steps saw nothing.
    """
    table, rows = [], []
    for method, repetitions in runs.items():
        end = (ends or {}).get(method, 1e6)
        for seed, steps in enumerate(repetitions):
            key = {
                "id": f"{method}-{seed}",
                "problem": "pacejka-tire_lf",
                "optimizer": method,
                "seed": seed,
            }
            final = steps[-1][1] if steps else np.nan
            table.append(
                key
                | spent(end)
                | {
                    "outcome": (outcomes or {}).get(method, "budget"),
                    "error": final,
                    "unit": unit,
                    "setup_seconds": 0.1,
                    "irreducible_low": irreducible[0],
                    "irreducible_high": irreducible[1],
                }
            )
            rows += [key | spent(at) | {"error": error} for at, error in steps]
            rows += [key | spent(end) | {"error": final}] if steps else []
    return pd.DataFrame(table), pd.DataFrame(rows)


def spent(evaluations: float) -> dict[str, float]:
    seconds = evaluations * SECONDS_PER_EVALUATION
    return {"evaluations": evaluations, "seconds": seconds, "cpu_seconds": 0.9 * seconds}


def like_fig6(seeds: int = 5) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Eight methods whose curves look like the paper's; 3 s per run, errors from 391 N up."""
    shapes = {
        # start, floor, evaluations at half way, evaluations at the end, spread of the floor
        "miho": (9000, 391.5, 1500, 42_000, 0.002),
        "gbo_small": (60_000, 58_000, 1e4, 30_000, 0.3),
        "gbo_large": (60_000, 1630, 40, 30_000, 0.1),
        "pso_100": (8000, 750, 300, 42_000, 0.25),
        "pso_500": (7000, 510, 6000, 42_000, 0.12),
        "optuna_hyperband": (9000, 620, 700, 2500, 0.15),
        "random": (9000, 900, 800, 42_000, 0.1),
        "least_squares": (9000, 391.4, 150, 3000, 0.001),
    }
    rng = np.random.default_rng(6)
    runs: dict[str, list[Steps]] = {}
    for method, (start, floor, half, end, wobble) in shapes.items():
        repetitions = []
        for _ in range(seeds):
            at = np.unique(np.round(np.geomspace(1, end * 0.9, 60) * rng.uniform(0.8, 1.1, 60)))
            low = floor * (1 + wobble * rng.uniform(-0.2, 1))
            first = start * rng.lognormal(0, 0.3)
            drop = rng.uniform(0.6, 1.4) * half
            error = np.maximum.accumulate((low + (first - low) / (1 + (at / drop) ** 2))[::-1])[
                ::-1
            ]
            repetitions.append([(float(a), float(e)) for a, e in zip(at, error, strict=True)])
        runs[method] = repetitions
    return frames(
        runs,
        ends={method: shape[3] for method, shape in shapes.items()},
        outcomes={"miho": "converged", "least_squares": "converged"},
        irreducible=(378.0, 398.0),
    )
