"""Write the finished runs of a root into MLflow: what is missing, half there or not equal.

python -m experiments.sync runs/identify                  # a database below runs/identify/.mlflow
python -m experiments.sync runs/identify --uri http://tracker:5000 --experiment tires

MLflow then shows for each run its settings, results and the error over evaluations (x-axis: step)
or over seconds (x-axis: relative time), and the figures of the root. Its charts join the points by
straight lines; the true curve is a step function, whole in each run's curve.csv.

MLflow keeps absolute paths: after a root was moved, delete its .mlflow and write it again.
"""

from __future__ import annotations

import argparse
import importlib.util
import shlex
import sys
from collections import Counter
from importlib.metadata import version
from pathlib import Path

from experiments.app.arguments import root_folder
from experiments.app.console import OK, SOME_FAILED, run_and_exit
from experiments.app.mirror import sync
from experiments.app.mlflow_tracker import as_tracker_error, connect
from miho.study import load_runs


def main() -> int:
    """Read the command line; 3 if some runs could not be written."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.sync",
        description="Mirror finished runs into MLflow. What is there and equal is left as it is.",
    )
    parser.add_argument("root", type=root_folder, help="folder of runs")
    parser.add_argument("--uri", help="of the tracker; by default SQLite below ROOT/.mlflow")
    parser.add_argument("--experiment", help="its name there; by default that of the root")
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
        f"{synced.repaired} repaired, {len(synced.failed)} failed; "
        f"{figures} figures and tables added"
    )
    if arguments.uri is None:
        address = f"sqlite:///{tracker.lock.with_suffix('')}"
        print(f"look at them: {pages_need()}mlflow ui --backend-store-uri {shlex.quote(address)}")
    return SOME_FAILED if synced.failed else OK


def pages_need() -> str:
    """What to install before the pages can be looked at: the extra only writes, and stays light."""
    if importlib.util.find_spec("flask") is not None:
        return ""
    return f"pip install mlflow=={version('mlflow-skinny')} && "


if __name__ == "__main__":
    run_and_exit(main)
