"""Collect the curves of all finished runs of a root in one file, so that they are read faster.

python -m experiments.compact runs/arena
"""

from __future__ import annotations

import argparse

from experiments.app.arguments import root_folder
from experiments.app.console import run_and_exit
from miho.study.compaction import compact


def main() -> None:
    """Parse the arguments and compact the root."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.compact",
        description="Collect the curves of all finished runs in one file, so that they are read "
        "faster. The file is a cache: it changes no run, later runs are read from their folders, "
        "and it can be deleted or rewritten at any time.",
    )
    parser.add_argument("root", type=root_folder, help="folder of runs")
    arguments = parser.parse_args()

    def job() -> None:
        print(f"{compact(arguments.root):,} curves compacted")

    run_and_exit(job)


if __name__ == "__main__":
    main()
