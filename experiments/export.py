"""Export the runs of a root in a format that other tools read.

python -m experiments.export runs/arena --to csv                      # runs/arena/exports/csv
python -m experiments.export runs/arena ioh-folder   # IOHprofiler: IOHanalyzer, iohinspector

CSV has two tables: one row per run, and one row per step of each curve. columns.json gives the
meaning and the unit of each column, and the checksums of both files. Other formats are written by
pandas: `miho.load_runs("runs/arena").runs.to_parquet("runs.parquet")`.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from experiments.app.arguments import root_folder
from experiments.app.build import ConfigError
from experiments.app.console import run_and_exit
from miho.analysis.export import write_csv, write_ioh
from miho.study import load_runs

WRITERS = {"ioh": write_ioh, "csv": write_csv}


def main() -> None:
    """Parse the arguments and export."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.export",
        description="Export finished runs: as tables in CSV, or in the IOHprofiler "
        "format (errors over evaluations, a folder for each method), which IOHanalyzer and "
        "iohinspector read. Parquet: miho.load_runs(root).runs.to_parquet(file).",
    )
    parser.add_argument("root", type=root_folder, help="folder of runs")
    parser.add_argument("folder", type=Path, nargs="?", help="the same as --output")
    parser.add_argument("--to", choices=sorted(WRITERS), default="ioh", help="format (ioh)")
    parser.add_argument(
        "--output", type=Path, help="folder, new or empty for ioh; by default ROOT/exports/FORMAT"
    )
    arguments = parser.parse_args()
    if arguments.folder is not None and arguments.output is not None:
        parser.error("give the folder once: as the second argument or with --output")
    output = arguments.output or arguments.folder
    if output is None:
        output = arguments.root / "exports" / arguments.to

    def job() -> None:
        stored = load_runs(arguments.root)
        if stored.runs.empty:
            raise ConfigError(
                f"{arguments.root}: holds no finished runs; run experiments.identify first"
            )
        try:
            WRITERS[arguments.to](stored.runs, stored.curves, output)
        except (ValueError, FileExistsError, ModuleNotFoundError) as error:
            raise ConfigError(str(error)) from None
        if len(stored.damaged):
            print(f"{len(stored.damaged)} damaged runs were left out", file=sys.stderr)
        print(f"{len(stored.runs)} runs in {output}")

    run_and_exit(job)


if __name__ == "__main__":
    main()
