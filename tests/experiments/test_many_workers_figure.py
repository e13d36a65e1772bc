"""The figure of many workers shows what its frame holds."""

from __future__ import annotations

import pandas as pd
import pytest

from experiments.benchmarks.many_workers import PANELS, many_workers_figure


def test_a_frame_of_another_benchmark_is_refused() -> None:
    with pytest.raises(ValueError, match="lacks the columns"):
        many_workers_figure(pd.DataFrame({"kind": ["method"]}))


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
