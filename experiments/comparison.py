"""A finished comparison for commands: read whole, its tables and where it comes from."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from experiments.app.build import ConfigError
from miho.analysis.compare.comparison import Comparison
from miho.study import load_runs, read_run, write_text
from miho.study.provenance import write_provenance


def read_comparison(root: Path) -> Comparison:
    """The last comparison below `root`; raises ConfigError if it is not there or not whole."""
    stored = load_runs(root)
    comparison = Comparison.of(stored.runs, stored.curves, root)
    if comparison is None:
        raise ConfigError(
            f"{root}: holds no comparison; run python -m experiments.compare root={root} first"
        )
    if comparison.missing:
        raise ConfigError(
            f"{root}: runs of the comparison are missing ({comparison.missing}); compare again"
        )
    return comparison


def write_tables(
    comparison: Comparison,
    tables: Mapping[str, pd.DataFrame],
    captions: Mapping[str, str],
    output: Path,
) -> list[Path]:
    """Each table as CSV and as Markdown with its caption, which is printed as well."""
    from miho.analysis import to_markdown  # loaded when a comparison is over

    output.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, table in tables.items():
        text = f"{captions[name]} Runs: {comparison.note}.\n\n{to_markdown(table)}"
        print(text)
        write_text(output / f"{name}.csv", table.to_csv(index=False))
        write_text(output / f"{name}.md", text)
        paths += [output / f"{name}.csv", output / f"{name}.md"]
    return paths


def write_origin(comparison: Comparison, output: Path) -> Path:
    """What regenerates a comparison, and what it ran on."""
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
