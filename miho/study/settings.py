"""Settings that differ among runs, as columns of their tables."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import orjson
import pandas as pd

from miho.study.files import MALFORMED, decoded
from miho.study.identity import canonical
from miho.study.provenance import flattened

CODE, DATA = "code", "data"
OPTIMIZER = "optimizer"
THETA = "theta"
DIGEST = 6
"""Hexadecimal digits of a digest in a column."""

Parts = Mapping[str, bytes]
"""The groups of a configuration as JSON; most runs share most of them."""


class RunRequest(NamedTuple):
    """Request of a run, digests of its code and data, and the text of its environment."""

    problem: str
    optimizer: str
    seed: int
    parts: Parts
    code: str
    data: str
    environment: bytes = b"{}"


def parts_of(config: bytes) -> dict[str, bytes]:
    """The groups of a `config.json`; empty if the text is not a configuration.

    Settings outside of groups are omitted, and so is a group named like the parameters of runs.
    """
    try:
        groups = decoded(config).items()
        return {
            name: orjson.dumps(group, option=orjson.OPT_SORT_KEYS)
            for name, group in groups
            if isinstance(group, dict) and name != THETA
        }
    except MALFORMED:
        return {}


def is_setting(column: str) -> bool:
    """Return whether a column of `miho.load_runs` is a setting that differs among its runs."""
    return column in (CODE, DATA) or ("." in column and not column.startswith(f"{THETA}."))


def differing(requests: Sequence[RunRequest]) -> pd.DataFrame:
    """A column for each setting that differs, with one row per run.

    Settings of the optimizer are compared among runs of one method, all others among runs of one
    problem. Otherwise each method and each problem of a sweep would add all its settings. Values
    that equal the seed are not settings. Lists are JSON texts. Digests of code and data are columns
    if they differ among runs that are otherwise equal.
    """
    distinct = {(a.problem, a.optimizer, id(a.parts), a.code, a.data): a for a in requests}
    runs = list(distinct.values())
    columns: dict[str, list[Any]] = {}
    for name, path in _varying(runs):
        values = [_leaves(a.parts.get(name, b"{}")).get(path) for a in requests]
        if any(value != a.seed for value, a in zip(values, requests, strict=True)):
            columns[f"{name}.{path}"] = values
    if _several([((a.problem, a.optimizer), a.code) for a in runs]):
        columns[CODE] = [a.code[:DIGEST] for a in requests]
    if _several([((a.problem, _outside_optimizer(a.parts)), a.data) for a in runs]):
        columns[DATA] = [a.data[:DIGEST] for a in requests]
    return pd.DataFrame(columns, index=range(len(requests)))


def _varying(runs: Sequence[RunRequest]) -> list[tuple[str, str]]:
    """Group and path of settings that differ within a method or problem; absent counts as null."""
    alike: dict[tuple[str, str], set[bytes]] = defaultdict(set)
    names = dict.fromkeys(name for run in runs for name in run.parts)
    for run in runs:
        for name in names:
            within = run.optimizer if name == OPTIMIZER else run.problem
            alike[name, within].add(run.parts.get(name, b"{}"))
    varying: dict[tuple[str, str], None] = {}
    for (name, _), texts in alike.items():
        if len(texts) > 1:
            several = [_leaves(text) for text in sorted(texts)]
            for path in dict.fromkeys(path for leaves in several for path in leaves):
                if len({leaves.get(path) for leaves in several}) > 1:
                    varying[name, path] = None
    return list(varying)


@lru_cache(maxsize=4096)
def _leaves(part: bytes) -> dict[str, Any]:
    """Settings of a group by dotted path; read-only, because it is cached."""
    leaves = flattened(orjson.loads(part))
    return {
        path: canonical(value) if isinstance(value, list | dict) else value
        for path, value in leaves.items()
    }


def _several(pairs: Sequence[tuple[Any, str]]) -> bool:
    """Return whether any key has more than one value."""
    return len(set(pairs)) > len({key for key, _ in pairs})


def _outside_optimizer(parts: Parts) -> tuple[tuple[str, bytes], ...]:
    return tuple((name, part) for name, part in parts.items() if name != OPTIMIZER)
