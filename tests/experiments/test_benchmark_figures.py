"""Figures of the benchmarks show what their frames hold."""

from __future__ import annotations

import pandas as pd
import pytest

from experiments.benchmarks.figures import arrival_figure, overhead_figure, run_figure
from experiments.benchmarks.workers_figures import PANELS, efficiency_figure, many_workers_figure

RUNS = pd.DataFrame({"form": ["plain loop", "steps"], "seconds": [30.0, 0.5], "speedup": [1, 60]})
METHODS = pd.DataFrame(
    {"kind": ["method", "method", "recorder", "method"], "name": ["a", "b", "c", "broken"],
     "us": [3.0, 0.5, 1.0, float("nan")]}
)  # fmt: skip


def test_run_figure_has_a_bar_per_form_with_its_speedup() -> None:
    (ax,) = run_figure(RUNS).axes
    assert [patch.get_width() for patch in ax.patches] == [30.0, 0.5]
    assert [text.get_text() for text in ax.texts] == ["30 s, 1 times", "0.5 s, 60 times"]


def test_overhead_figure_sorts_methods_and_leaves_out_what_was_not_measured() -> None:
    (ax,) = overhead_figure(METHODS).axes
    assert [tick.get_text() for tick in ax.get_yticklabels()] == ["b", "a"]


def test_arrival_figure_shows_medians_over_runs() -> None:
    runs = pd.DataFrame({"rows": 3000, "method": "miho_gn", "ms": [1.0, 2.0, 6.0]})
    (ax,) = arrival_figure(runs).axes
    assert list(ax.get_lines()[0].get_ydata()) == [2.0]


def test_a_frame_of_another_benchmark_is_refused() -> None:
    with pytest.raises(ValueError, match="lacks the columns"):
        overhead_figure(RUNS)


def test_efficiency_figure_has_a_line_per_engine_over_workers() -> None:
    rows = [("efficiency", engine, n, e) for engine, e in (("processes", 0.97), ("Dask", 0.9))
            for n in (1, 8)]  # fmt: skip
    frame = pd.DataFrame(
        [*rows, ("throughput", "MIHO", 32, 0.4)],
        columns=["kind", "name", "workers", "efficiency"],
    )
    (ax,) = efficiency_figure(frame).axes
    lines = {str(line.get_label()): list(line.get_ydata()) for line in ax.get_lines()}
    assert lines == {"processes": [0.97, 0.97], "Dask": [0.9, 0.9]}
    assert [tick.get_text() for tick in ax.get_xticklabels()] == ["1", "8"]


def test_many_workers_figure_has_a_panel_per_spread_and_medians_over_seeds() -> None:
    rows = [("simulated", method, n, spread, seed, factor * (seed + 1) / n)
            for method, factor in (("MIHO", 100.0), ("MIHO-GN", 10.0))
            for n in (1, 10) for spread in PANELS for seed in range(3)]  # fmt: skip
    columns = ["kind", "method", "workers", "spread", "seed", "seconds"]
    checked = ("check", "MIHO", 4, "equal", 0, 3.0)
    figure = many_workers_figure(pd.DataFrame([*rows, checked], columns=columns))
    assert len(figure.axes) == len(PANELS)
    for ax in figure.axes:
        lines = {str(line.get_label()): list(line.get_ydata()) for line in ax.get_lines()}
        assert lines["MIHO"] == [200.0, 20.0]
        assert lines["MIHO-GN"] == [20.0, 2.0]
