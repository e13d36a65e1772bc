"""Draw the paper's figures from the store.

python -m experiments.figures fig6   # error over time, and the claims table, of the methods that
                                     # a root holds runs of (by default after `compare`)
python -m experiments.figures fig6 root=runs/identify methods=paper   # the paper's five and Optuna
python -m experiments.figures fig4   # the four learned tires, and the front axle on a drive
                                     # (after `identify` on each of the tires)
python -m experiments.figures arena  # leaderboard, tests and profiles (after experiment=arena)
python -m experiments.figures fig4_right # the front axle over laps it was not learned from (after
                                         # `identify` with dataset=axle_log and dataset.end)
python -m experiments.figures fig5   # torque curves and engine map (after `identify` on torque_*)
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from experiments.app.arguments import as_options
from experiments.app.console import run_and_exit
from experiments.app.drawing import (
    draw_arena,
    draw_axle,
    draw_comparison,
    draw_engine,
    draw_tires,
)

OPTIONS = ("root", "output", "optimizer", "methods", "problem")
"""May be given as --root PATH and as root=PATH."""


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.figures",
        description="Draw a figure of the paper from finished runs, as PNG and PDF. Each option "
        "may be written as an override is as well: root=PATH.",
    )
    parser.add_argument("name", choices=("fig4", "fig4_right", "fig5", "fig6", "arena"))
    parser.add_argument(
        "--root",
        type=Path,
        help="folder of runs (fig6: runs/compare; arena: runs/arena; else runs/identify)",
    )
    parser.add_argument("--output", type=Path, help="where to write (default: ROOT/figures)")
    parser.add_argument(
        "--optimizer", default="miho", help="of fig4, fig4_right, fig5 (default: miho)"
    )
    parser.add_argument(
        "--methods", metavar="NAME,NAME", help="of fig6: paper, or some of those of the root (all)"
    )
    parser.add_argument("--problem", help="of fig6, where the root holds runs on several")
    arguments = parser.parse_args(as_options(sys.argv[1:], OPTIONS))
    usual = {"fig6": "compare", "arena": "arena"}.get(arguments.name, "identify")
    root = arguments.root or Path("runs", usual)
    output = arguments.output or root / "figures"
    methods = arguments.methods
    if methods not in (None, "paper"):
        methods = methods.split(",")

    def job() -> None:
        if arguments.name == "fig6":
            paths = draw_comparison(root, output, methods=methods, problem=arguments.problem)
        elif arguments.name == "arena":
            paths = draw_arena(root, output)
        else:
            draw = {"fig4": draw_tires, "fig4_right": draw_axle, "fig5": draw_engine}
            paths = draw[arguments.name](root, output, arguments.optimizer)
        print("\n".join(map(str, paths)))

    run_and_exit(job)


if __name__ == "__main__":
    main()
