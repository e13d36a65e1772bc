"""Put the curves of all finished runs of a root into one file, which makes reading them faster.

python -m experiments.compact runs/arena
"""

from __future__ import annotations

import argparse

from experiments.app.arguments import root_folder
from experiments.app.console import run_and_exit
from miho.study.compaction import compact


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.compact",
        description="Put the curves of all finished runs into one file, which makes reading them "
        "faster. It is a cache: the runs stay as they are, runs that come later are read from "
        "their own files, and it can be removed or written again at any time.",
    )
    parser.add_argument("root", type=root_folder, help="folder of runs")
    arguments = parser.parse_args()

    def job() -> None:
        print(f"{compact(arguments.root):,} curves compacted")

    run_and_exit(job)


if __name__ == "__main__":
    main()
