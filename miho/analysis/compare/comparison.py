"""The comparison that a root holds: which of its runs are compared, and how they were made."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

COMPARISON = "comparison.json"


@dataclass(frozen=True, eq=False)
class Comparison:
    """`runs` and `curves` as in `miho.load_runs`, of which `missing` runs are not there.

    `note` says how large it is, `command` are the words that made it.
    """

    runs: pd.DataFrame
    curves: pd.DataFrame
    missing: int
    command: tuple[str, ...]
    note: str

    @classmethod
    def of(cls, runs: pd.DataFrame, curves: pd.DataFrame, root: Path) -> Comparison | None:
        """The last comparison below a root, of all its runs; None if there is no readable one."""
        try:
            about = json.loads((root / COMPARISON).read_text(encoding="utf-8"))
            planned = set(map(str, about["runs"]))
            command, note = tuple(map(str, about["command"])), str(about["note"])
        except (FileNotFoundError, ValueError, LookupError, TypeError):
            return None
        runs = runs[runs["id"].isin(planned)]
        curves = curves[curves["id"].isin(planned)]
        return cls(runs, curves, len(planned) - len(runs), command, note)
