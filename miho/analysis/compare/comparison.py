"""The comparison in a root: its runs, their command, its tables and their origin."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import pandas as pd

from miho.analysis.compare.size import size_note
from miho.analysis.text import csv_text, to_markdown
from miho.study import read_run, write_text
from miho.study.provenance import write_provenance

COMPARISON = "comparison.json"


@dataclass(frozen=True, eq=False)
class Comparison:
    """Runs and curves as in `miho.load_runs`; `missing` planned runs are absent.

    `note` describes the size of the comparison; `command` is the command that made it.
    """

    runs: pd.DataFrame
    curves: pd.DataFrame
    missing: int
    command: tuple[str, ...]
    note: str

    @classmethod
    def of_stored(cls, runs: pd.DataFrame, curves: pd.DataFrame, command: Sequence[str]) -> Self:
        """A comparison of given runs; the size is read from their configurations."""
        return cls(runs, curves, 0, tuple(command), size_note(runs))

    @classmethod
    def of(cls, runs: pd.DataFrame, curves: pd.DataFrame, root: Path) -> Comparison | None:
        """The last comparison below a root, with all its runs; None if there is none."""
        try:
            about = json.loads((root / COMPARISON).read_text(encoding="utf-8"))
            planned = set(map(str, about["runs"]))
            command, note = tuple(map(str, about["command"])), str(about["note"])
        except (FileNotFoundError, ValueError, LookupError, TypeError):
            return None
        runs = runs[runs["id"].isin(planned)]
        curves = curves[curves["id"].isin(planned)]
        return cls(runs, curves, len(planned) - len(runs), command, note)


def write_comparison(root: Path, command: Sequence[str], note: str, ids: Sequence[str]) -> None:
    """Record the ids of the compared runs below a root."""
    about = {"command": list(command), "note": note, "runs": list(ids)}
    write_text(root / COMPARISON, json.dumps(about, indent=1) + "\n")


def write_tables(
    comparison: Comparison,
    tables: Mapping[str, pd.DataFrame],
    captions: Mapping[str, str],
    output: Path,
) -> tuple[list[str], list[Path]]:
    """Write tables as CSV and as Markdown with captions; return the Markdown and the paths."""
    output.mkdir(parents=True, exist_ok=True)
    texts, paths = [], []
    for name, table in tables.items():
        text = f"{captions[name]} Runs: {comparison.note}.\n\n{to_markdown(table)}"
        texts.append(text)
        write_text(output / f"{name}.csv", csv_text(table))
        write_text(output / f"{name}.md", text)
        paths += [output / f"{name}.csv", output / f"{name}.md"]
    return texts, paths


def write_origin(comparison: Comparison, output: Path) -> Path:
    """Write the command and the machine of a comparison."""
    runs = comparison.runs
    stored = [read_run(Path(folder)) for folder in runs["folder"]]
    loads = [run.environment["load"] for run in stored]
    facts = {
        "seeds": f"{runs['seed'].min()} to {runs['seed'].max()}",
        "code": sorted({run.result["code"] for run in stored}),
        "data": sorted({run.result["data"] for run in stored}),
        "drawn with python": platform.python_version(),
        "largest load average during the runs": max(
            (load[0] for load in loads if load), default=None
        ),
    }
    return write_provenance(output / "provenance.json", " ".join(comparison.command), stored, facts)
