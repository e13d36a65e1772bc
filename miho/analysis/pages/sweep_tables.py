"""Tables of a sweep, and warnings for its reader."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from itertools import product
from numbers import Real

import numpy as np
import pandas as pd

from miho.analysis.compare.bootstrap import interval, resample
from miho.analysis.pages.sweep_curves import final_order
from miho.analysis.pages.sweep_runs import Origin, Sweep
from miho.analysis.styles import styles_of
from miho.analysis.text import number, significant
from miho.analysis.tidy import shown_unit
from miho.analysis.timing import clock_of

FEW = 5
"""Repetitions below which a bootstrap interval is much too short; see `statistics`."""
SHORT = 12
"""Hexadecimal digits of a digest that are shown."""


def final_errors(runs: pd.DataFrame) -> pd.DataFrame:
    """A row per method on one problem, best median first; errors in the shown unit.

    The interval is the 95 % percentile bootstrap of the median over seeds, "-" for a single run. A
    run without a finite value counts as infinitely bad.
    """
    unit, factor = shown_unit(str(runs["unit"].iloc[0]))
    names = printed(runs["optimizer"])
    rng = np.random.default_rng(0)
    rows = []
    columns = runs[["optimizer", "error", "evaluations", "seconds", "outcome"]]
    groups = dict(iter(columns.groupby("optimizer", sort=False)))
    for method in final_order(runs):
        group = groups[method]
        final = (group["error"] * factor).fillna(np.inf).to_numpy(dtype=float)
        several = len(final) > 1
        medians = np.median(final[resample(len(final), rng)], axis=1)
        median = interval(medians, medians)
        low, high = significant(median.low), significant(median.high)
        ends = group["outcome"].value_counts()
        rows.append(
            {
                "method": names[method],
                "runs": len(group),
                f"median error [{unit}]": significant(median.estimate),
                "95 % interval": f"[{low}, {high}]" if several else "-",
                f"best [{unit}]": significant(final.min()),
                f"worst [{unit}]": significant(final.max()),
                "evaluations": number(group["evaluations"].median()),
                "seconds": number(group["seconds"].median()),
                "ended by": ", ".join(f"{outcome} {count}" for outcome, count in ends.items()),
            }
        )
    return pd.DataFrame(rows)


def printed(methods: pd.Series) -> dict[str, str]:
    """The name of each method in figures."""
    return {name: style.name for name, style in styles_of(map(str, methods.unique())).items()}


def problems_table(sweep: Sweep) -> pd.DataFrame:
    """A row per problem: its parts, its data digest and its size."""
    rows = []
    for problem, group in sweep.runs.groupby("problem", sort=False):
        origin = sweep.origins[group["folder"].iloc[0]]
        rows.append(
            {
                "problem": problem,
                "model": _target(origin, "model"),
                "dataset": _target(origin, "dataset"),
                "loss": _target(origin, "loss"),
                "parameters": int(group["dimension"].iloc[0]),
                "runs": len(group),
                "data digest": origin.data[:SHORT],
            }
        )
    return pd.DataFrame(rows)


def methods_table(sweep: Sweep) -> pd.DataFrame:
    """A row per method: its runs, their seeds and the digest of its code."""
    names = printed(sweep.runs["optimizer"])
    rows = []
    for method, group in sweep.runs.groupby("optimizer", sort=False):
        codes = dict.fromkeys(sweep.origins[folder].code[:SHORT] for folder in group["folder"])
        rows.append(
            {
                "method": names[str(method)],
                "runs": len(group),
                "seeds": seeds_text(group["seed"]),
                "code digest": ", ".join(codes),
            }
        )
    return pd.DataFrame(rows)


def seeds_text(seeds: pd.Series) -> str:
    """Seeds, for example "0 to 9", or all of them if the range has gaps."""
    values = sorted(int(seed) for seed in seeds.unique())
    if len(values) > 2 and values[-1] - values[0] == len(values) - 1:
        return f"{values[0]} to {values[-1]}"
    return ", ".join(map(str, values))


def warnings(sweep: Sweep) -> list[str]:
    """Warnings that a reader should know first, one sentence each."""
    runs = sweep.runs
    note, count = clock_of(runs).note, len(sweep.damaged)
    sentences = [*_gaps(runs), *_ends(runs), *_mixtures(list(sweep.origins.values()))]
    if note:
        sentences.append(f"{note[0].upper()}{note[1:]}.")
    if count:
        are = "run folders are damaged and are" if count > 1 else "run folder is damaged and is"
        sentences.append(f"{count} {are} omitted; see the list at the end.")
    return sentences


def _gaps(runs: pd.DataFrame) -> list[str]:
    """Warnings about missing and few repetitions."""
    sentences = []
    pairs = Counter(zip(runs["problem"], runs["optimizer"], strict=True))
    largest = max(pairs.values())
    every = product(runs["problem"].unique(), runs["optimizer"].unique())
    lacking = [pair for pair in every if pairs[pair] < largest]
    if lacking:
        problem, method = lacking[0]
        more = f", and {len(lacking) - 1} more like it" if len(lacking) > 1 else ""
        sentences.append(
            f"Not every method has the same runs: {method} has {pairs[lacking[0]]} of {largest} on "
            f"{problem}{more}."
        )
    if largest < FEW:
        sentences.append(
            f"No method has more than {largest} run{'s' * (largest > 1)} on a problem, so medians "
            "depend on chance and intervals are too short."
        )
    return sentences


def _ends(runs: pd.DataFrame) -> list[str]:
    silent = int(runs["error"].isna().sum())
    failed = int((runs["outcome"] == "failed").sum())
    sentences = []
    if silent:
        sentences.append(f"{silent} of {len(runs)} runs found no finite value; they rank last.")
    if failed:
        sentences.append(f"{failed} of {len(runs)} runs ended because the method failed.")
    return sentences


def _mixtures(origins: list[Origin]) -> list[str]:
    """Warnings about different machines, versions and thread counts, and about load."""
    sentences = []
    for subject, keys in {
        "machines": ("processor", "machine", "cores", "system"),
        "versions of Python or packages": ("python", "packages."),
        "numbers of threads": ("threads",),
    }.items():
        kinds = {
            tuple((k, v) for k, v in sorted(origin.environment.items()) if k.startswith(keys))
            for origin in origins
        }
        if len(kinds) > 1:
            sentences.append(
                f"The runs come from {len(kinds)} different {subject}: do not compare their "
                "seconds."
            )
    busy = sum(_busy(origin.environment) for origin in origins)
    if busy:
        sentences.append(
            f"{busy} of {len(origins)} runs were made with more processes waiting than the machine "
            "has cores, so their seconds are too long; evaluations are not affected."
        )
    return sentences


def _busy(environment: Mapping[str, str]) -> bool:
    """Return whether the load average exceeds the number of cores, if both are known."""
    load, cores = (json.loads(environment.get(key, "null")) for key in ("load", "cores"))
    first = load[0] if isinstance(load, list) and load else None
    return isinstance(first, Real) and isinstance(cores, Real) and float(first) > float(cores)


def _target(origin: Origin, group: str) -> str:
    """The last word of the target of a configuration group."""
    return origin.config.get(f"{group}._target_", '"-"').strip('"').rpartition(".")[2]
