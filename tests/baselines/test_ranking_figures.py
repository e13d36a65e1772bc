from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.text import Text

from baselines.arena.ranking import (
    LIGHT,
    area_figure,
    critical_difference_diagram,
    plot_areas,
    plot_cliques,
    plot_ranks,
    plot_speed_up,
    speed_up_figure,
)  # fmt: skip
from miho.analysis.compare.profiles import area_over_curve
from miho.analysis.compare.running_time import hits
from miho.analysis.compare.significance import (
    cliques,
    critical_difference,
    pairwise_speed_up,
    ranks,
)
from miho.analysis.styles import STYLES
from tests.analysis.arena_synthetic import areas, arena, methods, speed_ups

RANKS = pd.DataFrame(
    {"optimizer": ["random", "miho", "cma_es", "pso_100"], "rank": [3.9, 1.2, 2.0, 2.9]}
)


def rows(ax: Axes) -> list[str]:
    return [tick.get_text() for tick in ax.get_yticklabels()]


def test_areas_are_ordered_by_their_mean_over_problems() -> None:
    # the second run on a must not weigh more than the single one on b
    frame = pd.DataFrame(
        [("a", "random", 0.9), ("a", "random", 0.9), ("b", "random", 0.1),
         ("a", "miho", 0.6), ("b", "miho", 0.6)],
        columns=["problem", "optimizer", "aocc"],
    )  # fmt: skip
    ax = plot_areas(frame, Figure().subplots())
    assert rows(ax) == ["MIHO", "random search"]
    assert [text.get_text() for text in ax.texts] == ["0.60", "0.50"]
    diamonds = [np.asarray(dots.get_offsets())[0] for dots in ax.collections[1::2]]
    np.testing.assert_allclose(diamonds, [[0.6, 0], [0.5, 1]])


def test_ranks_are_dots_and_the_critical_difference_is_to_scale() -> None:
    ax = plot_ranks(RANKS, 1.35, Figure().subplots())
    assert rows(ax) == ["MIHO", "CMA-ES", "PSO-100", "random search"]
    dots = [np.asarray(collection.get_offsets())[0] for collection in ax.collections]
    np.testing.assert_allclose(dots, [[1.2, 0], [2.0, 1], [2.9, 2], [3.9, 3]])
    (bar,) = (line for line in ax.lines if line.get_marker() == "|")
    np.testing.assert_allclose(np.asarray(bar.get_xdata()), [1.2, 2.55])
    assert "critical difference 1.35" in [text.get_text() for text in ax.texts]


def test_a_bar_joins_the_rows_of_a_clique() -> None:
    ax = plot_cliques(RANKS, [("cma_es", "pso_100"), ("miho", "cma_es")], Figure().subplots())
    bars = [np.asarray(line.get_ydata()) for line in ax.lines if line.get_marker() == "o"]
    np.testing.assert_array_equal(bars, [[0, 1], [1, 2]])


def test_a_clique_of_strangers_is_refused() -> None:
    with pytest.raises(ValueError, match="has a method without a rank"):
        plot_cliques(RANKS, [("miho", "tpe")], Figure().subplots())


def speed_up_panel(**changes: float) -> Axes:
    row = {"method": "miho", "rival": "random", "ratio": 3.0, "low": 2.0, "high": 5.0,
           "problems": 7, "only_method": 2, "only_rival": 1} | changes  # fmt: skip
    return plot_speed_up(pd.DataFrame([row]), Figure().subplots(), method="miho")


def dot(ax: Axes) -> str:
    return to_hex(ax.collections[0].get_edgecolor()[0])


def test_a_speed_up_shows_its_interval_and_the_problems_behind_it() -> None:
    ax = speed_up_panel()
    np.testing.assert_allclose(np.asarray(ax.lines[0].get_xdata()), [2, 5])
    assert [text.get_text() for text in ax.texts][:2] == ["3×", "7 / 2 / 1"]
    assert ax.get_xscale() == "log"
    assert dot(ax) != LIGHT


@pytest.mark.parametrize(("low", "high"), [(0.8, 5.0), (1.0, 5.0), (0.1, np.inf)])
def test_an_interval_that_holds_one_is_undecided(low: float, high: float) -> None:
    ax = speed_up_panel(low=low, high=high)
    assert dot(ax) == LIGHT
    assert to_hex(ax.collections[0].get_facecolor()[0]) == "#ffffff"


def test_an_interval_without_end_has_an_arrow() -> None:
    assert len(speed_up_panel().collections) == 1
    assert len(speed_up_panel(high=np.inf).collections) == 2


def test_a_rival_without_a_common_problem_has_no_dot() -> None:
    ax = speed_up_panel(ratio=np.nan, low=np.nan, high=np.nan, problems=0)
    assert not ax.collections
    assert [text.get_text() for text in ax.texts][:2] == ["-", "0 / 2 / 1"]


def test_an_unknown_method_is_refused() -> None:
    with pytest.raises(ValueError, match="method is 'mihoo'; expected one of miho"):
        speed_up_figure(speed_ups(methods(4), 5), method="mihoo")


def test_figures_are_drawn_from_the_frames_of_the_statistics() -> None:
    runs, curves = arena(methods(4), 3, 3)
    areas = area_over_curve(runs, curves)
    scores = -areas.groupby(["problem", "optimizer"])["aocc"].mean().unstack()
    ranked = ranks(scores)
    cd = critical_difference(4, 3)
    pairs = pairwise_speed_up(hits(runs, curves), 1.01, "evaluations", np.random.default_rng(1), 50)
    sample = "3 problems in 2 families"
    figures = [
        area_figure(areas),
        critical_difference_diagram(ranked, cd, cliques(ranked, cd), sample=sample),
        speed_up_figure(pairs, method="miho"),
    ]
    assert rows(figures[1].axes[0]) == [STYLES[method].name for method in ranked["optimizer"]]
    assert f"mean rank over {sample} (1: best)" in {
        text.get_text() for text in figures[1].findobj(Text) if isinstance(text, Text)
    }


@pytest.mark.slow
def test_rows_of_twenty_two_methods_stay_on_the_page() -> None:
    many = methods(22)
    ranked = pd.DataFrame({"optimizer": many, "rank": np.arange(22) * 0.9 + 1.5})
    for figure in (
        area_figure(areas(many, 16)),
        critical_difference_diagram(ranked, 8.0, cliques(ranked, 8.0), sample="16 problems"),
        speed_up_figure(speed_ups(many, 16), method=many[0]),
    ):
        figure.draw_without_rendering()
        boxes = [text.get_window_extent() for text in figure.findobj(Text) if text.get_text()]
        assert min(box.x0 for box in boxes) >= -1
        assert max(box.x1 for box in boxes) <= figure.bbox.x1 + 1
        assert max(box.y1 for box in boxes) <= figure.bbox.y1 + 1
