"""Time to make a report: 3000 rows, 5 parameters, with and without 1000 bootstrap replicates.

python -m experiments.benchmarks.report_time
"""

from __future__ import annotations

import tempfile
from time import perf_counter

from experiments.app.build import build
from experiments.app.compose import composed
from experiments.app.execution import execution_of
from experiments.app.optimum import report_of, save_run
from experiments.app.schema import register

REPEATS = 5


def main() -> None:
    """Identify tire LF once, then time reports on the result."""
    register()
    with tempfile.TemporaryDirectory() as root:
        experiment = build(composed(["dataset=tire_lf", "optimizer=least_squares", f"root={root}"]))
        stored = execution_of(experiment).run
        if stored is None:
            raise RuntimeError("the run failed")
        for repeat in range(REPEATS):
            start = perf_counter()
            report = report_of(experiment.problem, stored)
            computed = perf_counter()
            save_run(report, stored)
            print(
                f"report {repeat}: computed in {computed - start:.2f} s, with tables, page and "
                f"parameters.json in {perf_counter() - start:.2f} s"
            )
        start = perf_counter()
        report_of(experiment.problem, stored, replicates=1000, profiles=False)
        print(f"bootstrap of 1000: {perf_counter() - start:.2f} s")


if __name__ == "__main__":
    main()
