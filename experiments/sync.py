"""Copy the finished runs of a root to MLflow that it lacks.

python -m experiments.sync runs/identify                  # a database below runs/identify/.mlflow
python -m experiments.sync runs/identify --uri http://tracker:5000 --experiment tires

MLflow then shows the settings and results of each run, the error over evaluations (x-axis: step)
or over seconds (x-axis: relative time), and the figures of the root. Its charts join the points by
straight lines; the true curve is a step function, stored completely in curve.csv of each run.

MLflow stores absolute paths: after a root was moved, delete its folder .mlflow and copy again.
"""

import argparse
import importlib.util
import shlex
import sys
from collections import Counter
from importlib.metadata import version
from pathlib import Path

from experiments.app.console import OK, SOME_FAILED, root_folder, run_and_exit
from experiments.app.mirror import sync
from experiments.app.mlflow_tracker import as_tracker_error, connect
from miho.study import load_runs


def main() -> int:
    """Parse the arguments and copy; return 3 if some runs could not be written."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.sync",
        description="Copy finished runs to MLflow. Runs that are there are not touched.",
    )
    parser.add_argument("root", type=root_folder, help="folder of runs")
    parser.add_argument("--uri", help="address of the tracker (a SQLite file below ROOT/.mlflow)")
    parser.add_argument("--experiment", help="name of the experiment in MLflow (name of the root)")
    arguments = parser.parse_args()
    stored = load_runs(arguments.root)
    tracker = connect(arguments.root, arguments.uri, arguments.experiment)
    with as_tracker_error():
        synced = sync([Path(folder) for folder in stored.runs["folder"]], tracker)
        figures = 0 if synced.failed else tracker.attach(arguments.root)
    for reason, times in Counter(synced.failed.values()).items():
        first = next(folder for folder in synced.failed if synced.failed[folder] == reason)
        more = f" (and {times - 1} more)" if times > 1 else ""
        print(f"error: {first}: {reason}{more}", file=sys.stderr)
    for row in stored.damaged.itertuples():
        print(f"damaged, left out: {row.folder}: {row.reason}", file=sys.stderr)
    print(
        f"{len(stored.runs)} runs: {synced.there} were there, {synced.added} added, "
        f"{len(synced.failed)} failed; {figures} figures and tables added"
    )
    if arguments.uri is None:
        address = f"sqlite:///{tracker.lock.with_suffix('')}"
        print(f"look at them: {pages_need()}mlflow ui --backend-store-uri {shlex.quote(address)}")
    return SOME_FAILED if synced.failed else OK


def pages_need() -> str:
    """Command that installs the server of the pages, if it is missing: the extra only writes."""
    if importlib.util.find_spec("flask") is not None:
        return ""
    return f"pip install mlflow=={version('mlflow-skinny')} && "


if __name__ == "__main__":
    run_and_exit(main)
