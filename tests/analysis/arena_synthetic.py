"""Many methods on many problems, with a known order: method k of the list is the k-th best."""

from __future__ import annotations

import numpy as np
import pandas as pd

from miho.analysis.styles import STYLES

PROBLEMS = (
    "pacejka-sample_a-wide", "pacejka-sample_a-physical", "pacejka-sample_b-wide",
    "pacejka-sample_b-physical", "pacejka-tire_lf", "pacejka-tire_rf", "pacejka-tire_lr",
    "pacejka-tire_rr", "torque-20", "torque-50", "torque-100", "brake-static", "brake-play",
    "axle-front", "mf61-lateral", "single_track-output_error", "pacejka-heavy_tails",
    "pacejka-fails",
)  # fmt: skip
FACTORS = (1.5, 1.1, 1.01, 1.001)
BUDGET = 50_000


def methods(count: int) -> list[str]:
    return list(STYLES)[:count]


def arena(
    methods: list[str], problems: int, seeds: int = 4, silent: int = 0
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Runs and curves: gaps fall as powers of evaluations, more slowly down the list.

    On the last problem the optimum is unknown and `silent` runs of each method see no value.
    """
    rng = np.random.default_rng(7)
    runs, rows = [], []
    for place, problem in enumerate(PROBLEMS[:problems]):
        best = 10.0 ** rng.uniform(0, 3)
        last = place == problems - 1
        for order, method in enumerate(methods):
            slope = 1.9 / (1 + 0.22 * order) * rng.uniform(0.75, 1.25)
            floor = 10.0 ** rng.uniform(-8, -5 + 0.25 * order)
            for seed in range(seeds):
                key = {"id": f"{problem}-{method}-{seed}", "problem": problem,
                       "optimizer": method, "seed": seed}  # fmt: skip
                drop = 60 * rng.lognormal(0, 0.5)
                at = np.unique(np.geomspace(1, BUDGET, 40).round())
                gap = 80 / (1 + (at / drop) ** slope) ** 2 + floor
                error = best * (1 + gap)
                cost = 1e-5 * (1 + order)
                end = {"evaluations": BUDGET, "seconds": BUDGET * cost, "cpu_seconds": 0.0}
                quiet = last and seed < silent
                runs.append(key | end | {
                    "error": np.nan if quiet else error[-1], "outcome": "budget", "unit": "N",
                    "irreducible_low": np.nan, "irreducible_high": np.nan,
                    "optimum": np.nan if last else best,
                })  # fmt: skip
                if not quiet:
                    rows.append(pd.DataFrame(
                        key | {"evaluations": at, "seconds": at * cost, "cpu_seconds": 0.0,
                               "error": error}
                    ))  # fmt: skip
    return pd.DataFrame(runs), pd.concat(rows, ignore_index=True)


def running_times(methods: list[str], problems: int) -> pd.DataFrame:
    """Expected running times that grow down the list; the tail of it never arrives or seldom."""
    rng = np.random.default_rng(8)
    rows = []
    for place, problem in enumerate(PROBLEMS[:problems]):
        for order, method in enumerate(methods):
            never = order > 0.6 * len(methods) and (order + place) % 3 == 0
            share = 0.0 if never else float(rng.choice([1, 1, 1, 0.9, 0.6, 0.1]))
            cost = 300 * 1.45**order * rng.lognormal(0, 0.5) / max(share, 1e-9)
            rows.append({
                "problem": problem, "optimizer": method, "factor": 1.01, "runs": 10,
                "success": share, "ert": np.inf if never else cost,
                "low": 0.7 * cost, "high": 1.4 * cost, "median": cost,
            })  # fmt: skip
    return pd.DataFrame(rows)


def shares(methods: list[str], x: str, top: float) -> pd.DataFrame:
    """Rising shares over `x` from 1 to `top`, lower down the list."""
    at = np.geomspace(1, top, 60)
    pieces = [
        pd.DataFrame({
            "optimizer": method, x: at,
            "share": (1 - 0.03 * order) * np.round(
                1 / (1 + (top**0.35 * 1.12**order / at) ** 1.5), 2),
        })
        for order, method in enumerate(methods)
    ]  # fmt: skip
    return pd.concat(pieces, ignore_index=True)


def areas(methods: list[str], problems: int, seeds: int = 4) -> pd.DataFrame:
    rng = np.random.default_rng(9)
    rows = [
        {"problem": problem, "optimizer": method, "seed": seed,
         "aocc": float(np.clip(0.9 - 0.03 * order + rng.normal(0, 0.08), 0, 1))}
        for problem in PROBLEMS[:problems]
        for order, method in enumerate(methods)
        for seed in range(seeds)
    ]  # fmt: skip
    return pd.DataFrame(rows)


def speed_ups(methods: list[str], problems: int) -> pd.DataFrame:
    """The first method against the rest: the second undecided, the last never comparable."""
    rows = []
    for order, rival in enumerate(methods[1:]):
        ratio = 1.05 * 1.3**order
        row = {"method": methods[0], "rival": rival, "ratio": ratio, "low": ratio / 1.6,
               "high": ratio * 1.9, "problems": problems - order // 2,
               "only_method": order // 2, "only_rival": 0}  # fmt: skip
        rows.append(row)
    rows[-1] |= {"ratio": np.nan, "low": np.nan, "high": np.nan, "problems": 0}
    rows[-2] |= {"high": np.inf}
    return pd.DataFrame(rows)
