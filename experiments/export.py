"""Export the runs of a root as tables in CSV.

python -m experiments.export runs/arena            # into runs/arena/exports/csv
python -m experiments.export runs/arena FOLDER

There are two tables: one row per run, and one row per step of each curve. columns.json gives the
meaning and the unit of each column, and the checksums of both files. IOHanalyzer reads curves.csv
as a custom CSV file. Other formats are written by pandas:
`miho.load_runs("runs/arena").runs.to_parquet("runs.parquet")`.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from experiments.app.arguments import root_folder
from experiments.app.build import ConfigError
from experiments.app.console import run_and_exit
from miho.analysis.export import write_csv
from miho.study import load_runs
from miho.study.index import without_runs


def main() -> None:
    """Parse the arguments and export."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.export",
        description="Export finished runs as tables in CSV, which IOHanalyzer also reads. "
        "Parquet: miho.load_runs(root).runs.to_parquet(file).",
    )
    parser.add_argument("root", type=root_folder, help="folder of runs")
    parser.add_argument("folder", type=Path, nargs="?", help="the same as --output")
    parser.add_argument("--to", choices=["csv"], default="csv", help="format (csv)")
    parser.add_argument("--output", type=Path, help="folder; by default ROOT/exports/csv")
    arguments = parser.parse_args()
    if arguments.folder is not None and arguments.output is not None:
        parser.error("give the folder once: as the second argument or with --output")
    output = arguments.output or arguments.folder or arguments.root / "exports" / "csv"

    def job() -> None:
        stored = load_runs(arguments.root)
        if stored.runs.empty:
            raise ConfigError(without_runs(arguments.root))
        write_csv(stored.runs, stored.curves, output)
        if len(stored.damaged):
            print(f"{len(stored.damaged)} damaged runs were left out", file=sys.stderr)
        print(f"{len(stored.runs)} runs in {output}")

    run_and_exit(job)


if __name__ == "__main__":
    main()
