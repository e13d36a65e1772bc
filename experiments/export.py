"""Write the runs of a root in a format that other tools read.

python -m experiments.export runs/arena ioh-folder   # IOHprofiler: IOHanalyzer, iohinspector
"""

from __future__ import annotations

import argparse
from pathlib import Path

from experiments.build import ConfigError
from experiments.cli import guarded
from miho.analysis import write_ioh
from miho.study import load_runs


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.export",
        description="Export finished runs in the IOHprofiler format: errors over evaluations, a "
        "folder for each method. IOHanalyzer and iohinspector read it.",
    )
    parser.add_argument("root", type=Path, help="folder of runs")
    parser.add_argument("output", type=Path, help="a new or empty folder")
    arguments = parser.parse_args()

    def job() -> None:
        found = load_runs(arguments.root)
        if found.runs.empty:
            raise ConfigError(f"{arguments.root}: holds no finished runs; run something first")
        try:
            write_ioh(found.runs, found.curves, arguments.output)
        except (ValueError, FileExistsError) as error:
            raise ConfigError(str(error)) from None
        print(f"{len(found.runs)} runs in {arguments.output}")

    guarded(job)


if __name__ == "__main__":
    main()
