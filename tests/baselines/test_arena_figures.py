from __future__ import annotations

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from baselines.arena.figures import (
    ecdf_figure,
    error_curves,
    plot_gap,
    plot_shares,
    profiles_figure,
)  # fmt: skip
from miho.analysis.compare.profiles import data_profile, ecdf, performance_profile
from miho.analysis.compare.running_time import hits, running_times
from miho.analysis.styles import STYLES
from miho.analysis.timing import Clock, clock_of
from tests.analysis.arena_synthetic import arena, methods
from tests.analysis.synthetic import Steps, frames

WALL = Clock("seconds", pd.DataFrame(), "", "")

GRID = np.array([1.0, 10.0, 100.0, 1000.0])


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.findobj(Text) if isinstance(text, Text)]


def gap_panel(steps: list[Steps], ends: float = 1000.0, highlight: bool = True) -> Axes:
    """MIHO's runs against a best known error of 100 N."""
    runs, curves = frames({"miho": steps}, ends={"miho": ends})
    ax = Figure().subplots()
    style = STYLES["miho"] if highlight else STYLES["miho"].muted
    return plot_gap(runs, curves, ax, 100.0, GRID, {"miho": style})


def test_the_line_is_the_median_of_the_relative_gap() -> None:
    ax = gap_panel([[(1, 300.0), (10, 150.0)], [(1, 500.0), (100, 110.0)], [(1, 400.0)]])
    np.testing.assert_allclose(np.asarray(ax.lines[0].get_ydata()), [3, 3, 0.5, 0.5])


def test_a_median_begins_where_more_than_half_of_the_runs_have_a_value() -> None:
    ax = gap_panel([[(1, 300.0)], [(10, 200.0)], []])
    np.testing.assert_allclose(np.asarray(ax.lines[0].get_ydata()), [np.nan, 2, 2, 2])
    ax = gap_panel([[(1, 300.0)], []])
    assert np.isnan(np.asarray(ax.lines[0].get_ydata(), dtype=float)).all()


def test_a_gap_that_is_not_positive_is_drawn_at_the_floor() -> None:
    ax = gap_panel([[(1, 300.0), (10, 100.0), (100, 99.999)]])
    np.testing.assert_allclose(np.asarray(ax.lines[0].get_ydata()), [2, 1e-6, 1e-6, 1e-6])
    assert ax.get_ylim()[0] < 1e-6


def test_a_line_ends_where_the_last_run_ended() -> None:
    ax = gap_panel([[(1, 300.0)]] * 2, ends=100.0)
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), GRID[:3])
    np.testing.assert_allclose(np.asarray(ax.lines[0].get_ydata()), [2, 2, 2])


def test_an_improvement_at_the_end_of_a_run_is_drawn() -> None:
    """The run ends between two positions of the grid, as a run that reaches its target does."""
    ax = gap_panel([[(1, 300.0), (40, 101.0)]], ends=40.0)
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), GRID[:3])
    np.testing.assert_allclose(np.asarray(ax.lines[0].get_ydata()), [2, 2, 0.01])


def test_only_highlighted_methods_have_a_band() -> None:
    steps: list[Steps] = [[(1, 300.0)], [(1, 200.0)]]
    assert len(gap_panel(steps).collections) == 1
    assert not gap_panel(steps, highlight=False).collections


def test_each_problem_has_a_panel_and_an_unknown_optimum_a_star() -> None:
    others = ["hyperband", "dehb", "gbo_small"]
    figure = error_curves(*arena(["miho", *others], 3, 2), note="small size")
    written = texts(figure)
    assert len(figure.axes) == 3
    assert "pacejka-sample_a-wide" in written
    assert "pacejka-sample_b-wide *" in written
    assert any("*: best of all runs" in text for text in written)
    assert {"MIHO", "3 others"} <= set(written)
    assert any("small size" in text for text in written)
    assert all(len(ax.lines) == 4 for ax in figure.axes)


def test_a_single_method_in_the_background_has_its_name() -> None:
    assert "Hyperband" in texts(error_curves(*arena(["miho", "hyperband"], 3, 2)))


def test_a_share_is_drawn_as_a_step() -> None:
    frame = pd.DataFrame({"optimizer": "miho", "tau": [1.0, 10.0, 100.0], "share": [0.2, 0.4, 0.8]})
    ax = plot_shares(frame, "tau", Figure().subplots())
    assert ax.lines[0].get_drawstyle() == "steps-post"
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), [0.2, 0.4, 0.8])
    assert ax.get_xlim() == (1, 100)


def test_shares_without_any_success_still_draw() -> None:
    frame = pd.DataFrame({"optimizer": ["miho"], "tau": [1.0], "share": [0.0]})
    plot_shares(frame, "tau", Figure().subplots())


def test_the_distributions_end_at_the_share_of_targets_reached() -> None:
    first_hits = hits(*arena(methods(3), 2, 3, silent=1))
    figure = ecdf_figure(ecdf(first_hits, "evaluations"), ecdf(first_hits, "seconds"), WALL)
    written = texts(figure)
    for method, reached in first_hits.groupby("optimizer")["reached"].mean().items():
        assert f"{100 * reached:\u2007>3.0f} %  {STYLES[str(method)].name}" in written


def test_the_distribution_over_time_says_whose_seconds_it_shows() -> None:
    runs, curves = arena(methods(3), 2, 3)
    reached = hits(runs, curves.assign(cpu_seconds=0.5 * curves["seconds"]))
    over = ecdf(reached, "evaluations")
    clock = clock_of(runs.assign(timing_valid=False))
    figure = ecdf_figure(over, ecdf(reached, clock.axis), clock, note="2 problems")
    for ax in figure.axes:
        assert [line.get_drawstyle() for line in ax.lines].count("steps-post") == 3
    assert figure.axes[1].get_xlabel() == "CPU seconds\n(other work disturbed 18 of 18 runs)"
    clock = clock_of(runs.assign(timing_valid=runs["seed"] != 1))
    figure = ecdf_figure(over, ecdf(reached, clock.axis), clock)
    assert figure.axes[1].get_xlabel() == "time [s]"
    assert any("other work disturbed 6 of 18 runs" in written for written in texts(figure))


def test_the_profiles_end_at_the_share_of_problems_solved() -> None:
    reached = hits(*arena(methods(3), 2, 3))
    ert = running_times(reached, "evaluations")
    dimensions = dict.fromkeys(reached["problem"].unique(), 5)
    data = data_profile(reached, dimensions, 1.01)
    figure = profiles_figure(data, performance_profile(ert, 1.01))
    solved = np.isfinite(ert["ert"][ert["factor"] == 1.01]).groupby(ert["optimizer"]).mean()
    for method, share in solved.items():
        assert f"{100 * share:\u2007>3.0f} %  {STYLES[str(method)].name}" in texts(figure)


@pytest.mark.slow
def test_the_labels_of_twenty_two_methods_stay_apart_and_on_the_page() -> None:
    reached = hits(*arena(methods(22), 2, 2))
    figure = ecdf_figure(ecdf(reached, "evaluations"), ecdf(reached, "seconds"), WALL)
    figure.draw_without_rendering()
    names = tuple(f"%  {STYLES[method].name}" for method in methods(22))
    boxes = sorted(
        (
            text.get_window_extent()
            for text in figure.findobj(Text)
            if isinstance(text, Text) and text.get_text().endswith(names)
        ),
        key=lambda box: box.y0,
    )
    assert len(boxes) == 22
    assert figure.axes[0].bbox.y0 > figure.axes[1].bbox.y1, "a phone shows one panel at a time"
    assert all(below.y1 <= above.y0 + 1 for below, above in pairwise(boxes))
    assert max(box.x1 for box in boxes) <= figure.bbox.x1
