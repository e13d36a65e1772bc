"""Draw the paper's figures from stored runs.

python -m experiments.figures fig6   # error over time, and the claims table, of all methods with
                                     # runs in the root (by default the runs of `compare`)
python -m experiments.figures fig6 root=runs/identify methods=paper   # the paper's five and Optuna
python -m experiments.figures fig4   # the four identified tires, and the front axle on a drive
                                     # (after `identify` on each tire)
python -m experiments.figures arena  # leaderboard, tests and profiles (after experiment=arena)
python -m experiments.figures fig4_right # the front axle on laps that the fit did not use (after
                                         # `identify` with dataset=axle_log and dataset.end)
python -m experiments.figures fig5   # torque curves and engine map (after `identify` on torque_*)
"""

import argparse
import sys
from pathlib import Path

from experiments.app.console import as_options, run_and_exit
from experiments.app.drawing import draw_arena, draw_axle, draw_comparison, draw_engine, draw_tires
from experiments.app.safety import check_folder

OPTIONS = ("root", "output", "optimizer", "methods", "problem")
"""Options that may be written as --root PATH or as root=PATH."""


def main() -> None:
    """Parse the arguments and draw a figure."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.figures",
        description="Draw a figure of the paper from finished runs, as PNG and PDF. Options may "
        "also be written as overrides: root=PATH.",
    )
    parser.add_argument("name", choices=("fig4", "fig4_right", "fig5", "fig6", "arena"))
    parser.add_argument(
        "--root",
        type=Path,
        help="folder of runs (fig6: runs/compare; arena: runs/arena; else runs/identify)",
    )
    parser.add_argument(
        "--output", type=Path, help="folder of the figures (ROOT/figures; with a problem, below it)"
    )
    parser.add_argument(
        "--optimizer", default="miho", help="method of fig4, fig4_right and fig5 (miho)"
    )
    parser.add_argument(
        "--methods", metavar="NAME,NAME", help="for fig6: paper, or names of methods (all)"
    )
    parser.add_argument("--problem", help="for fig6, if the root holds runs on several problems")
    parser.add_argument(
        "--config-dir", type=Path, metavar="FOLDER", help="for arena: folder of your own problems"
    )
    arguments = parser.parse_args(as_options(sys.argv[1:], OPTIONS))
    usual = {"fig6": "compare", "arena": "arena"}.get(arguments.name, "identify")
    root = arguments.root or Path("runs", usual)
    output = arguments.output or root / "figures" / (arguments.problem or "")
    methods = arguments.methods
    if methods not in (None, "paper"):
        methods = methods.split(",")

    def job() -> None:
        if arguments.name == "fig6":
            paths = draw_comparison(root, output, methods=methods, problem=arguments.problem)
        elif arguments.name == "arena":
            if arguments.config_dir is not None:
                check_folder(arguments.config_dir)
            paths = draw_arena(root, output, arguments.config_dir)
        else:
            draw = {"fig4": draw_tires, "fig4_right": draw_axle, "fig5": draw_engine}
            paths = draw[arguments.name](root, output, arguments.optimizer)
        print("\n".join(map(str, paths)))

    run_and_exit(job)


if __name__ == "__main__":
    main()
