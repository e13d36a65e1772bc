"""Expected running times of MIHO and of iohinspector on the same export.

python -m experiments.check.ert ROOT     # after pip install 'miho[crosscheck]'

Exports the last comparison below ROOT in the IOHprofiler format, reads it with iohinspector and
compares expected running time and success rate of every method on every problem, at four targets.
iohinspector charges an unsuccessful run the whole budget; MIHO charges the evaluations that it
used. For the comparison, each run is charged as much as the longest run on its problem. The
leaderboard does not do so; hence the check compares its arithmetic, not its figures. Exits with 1
if a figure differs by more than 1e-12 (relative); both divide sums of integers.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any, cast

import numpy as np

from experiments.app.build import ConfigError
from experiments.app.console import run_and_exit
from experiments.app.drawing import read_comparison
from miho.analysis import write_ioh
from miho.analysis.compare.comparison import Comparison
from miho.analysis.compare.running_time import hits, running_times

TOLERANCE = 1e-12
PAIRS = (("ert", "ERT"), ("success", "success_ratio"))


def main() -> None:
    """Parse the arguments, export and compare."""
    parser = argparse.ArgumentParser(prog="python -m experiments.check.ert")
    parser.add_argument("root", type=Path, help="folder of a comparison")
    arguments = parser.parse_args()

    def job() -> None:
        largest, count = largest_difference(read_comparison(arguments.root))
        print(
            f"{count} expected running times and success rates, a failed run charged as much as "
            f"the longest on its problem (the leaderboard: what it spent): largest difference "
            f"{largest:.1e}"
        )
        if not largest <= TOLERANCE:
            sys.exit(1)

    run_and_exit(job)


def largest_difference(comparison: Comparison) -> tuple[float, int]:
    """Largest relative difference (inf if only one is finite), and the number of comparisons."""
    metrics, manager = _iohinspector()
    runs, curves = comparison.runs.copy(), comparison.curves.copy()
    for frame in (runs, curves):
        frame["evaluations"] = np.ceil(frame["evaluations"])
    runs["evaluations"] = runs.groupby("problem")["evaluations"].transform("max")
    reached = hits(runs, curves)
    times = running_times(reached, "evaluations")
    targets = reached.groupby(["problem", "factor"])["target"].first()
    longest = runs.groupby("problem")["evaluations"].first()
    with tempfile.TemporaryDirectory() as folder:
        write_ioh(runs, curves, folder)
        manager.add_folder(folder)
        data = manager.load(monotonic=True, include_meta_data=True)
    largest, count = 0.0, 0
    for place, target in targets.items():
        problem, factor = cast(tuple[str, float], place)
        on_target = times[(times["problem"] == problem) & (times["factor"] == factor)]
        table = metrics.aggregate_running_time(
            data.filter(data["function_name"] == problem),
            f_min=target,
            f_max=target,
            eval_max=int(longest[problem]),
        )
        names = list(table["algorithm_name"])
        for name, their_name in PAIRS:
            values = dict(zip(names, table[their_name], strict=True))
            for method, value in zip(on_target["optimizer"], on_target[name], strict=True):
                largest = max(largest, _difference(float(value), float(values[method])))
                count += 1
    return largest, count


def _difference(ours: float, theirs: float) -> float:
    if ours == theirs:
        return 0.0
    return abs(ours - theirs) / abs(theirs) if np.isfinite([ours, theirs]).all() else np.inf


def _iohinspector() -> tuple[Any, Any]:
    try:
        from iohinspector import DataManager, metrics
    except ImportError:
        raise ConfigError("iohinspector: is missing; pip install 'miho[crosscheck]'") from None
    return metrics, DataManager()


if __name__ == "__main__":
    main()
