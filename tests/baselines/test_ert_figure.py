from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from baselines.arena.figures import ert_table, plot_ert, short
from tests.analysis.arena_synthetic import methods, running_times

COLUMNS = ["problem", "optimizer", "factor", "success", "ert"]
ERT = pd.DataFrame(
    [
        ("b", "miho", 1.01, 1.0, 100.0),
        ("a", "miho", 1.01, 0.5, 300.0),
        ("b", "random", 1.01, 0.0, np.inf),
        ("a", "random", 1.01, 1.0, 150.0),
        ("b", "cma_es", 1.01, 0.9, 4200.0),
    ],
    columns=COLUMNS,
)


def drawn(rows: pd.DataFrame, order: pd.DataFrame | None = None) -> Figure:
    figure = Figure()
    plot_ert(rows, figure.subplots(), order=order)
    return figure


def cells(figure: Figure) -> list[tuple[int, int, str]]:
    """(row, column, text) of what is written into the cells."""
    entries = [(int(text.get_position()[1]), int(text.get_position()[0]), text.get_text())
             for text in figure.axes[0].texts if text.get_text() != "mean rank"]  # fmt: skip
    return sorted(entries)


def test_cells_hold_ratios_to_the_best_and_incomplete_success() -> None:
    # ranks: b 1, 3, 2 and a 2, 1, 3 (never run): MIHO 1.5, random search 2, CMA-ES 2.5
    assert cells(drawn(ERT)) == [
        (0, 0, "1.0"), (0, 1, "2.0"), (0, 1, "50 %"),
        (1, 0, "-"), (1, 1, "1.0"),
        (2, 0, "42"), (2, 0, "90 %"),
    ]  # fmt: skip


def test_methods_stand_in_the_order_of_their_mean_rank_which_is_printed() -> None:
    labels = [tick.get_text() for tick in drawn(ERT).axes[0].get_yticklabels()]
    assert labels == ["MIHO   1.5", "random search   2.0", "CMA-ES   2.5"]


def test_another_order_can_be_given() -> None:
    order = pd.DataFrame({"optimizer": ["cma_es", "miho", "random"], "rank": [1.0, 3.0, 2.5]})
    labels = [tick.get_text() for tick in drawn(ERT, order).axes[0].get_yticklabels()]
    assert labels == ["CMA-ES   1.0", "random search   2.5", "MIHO   3.0"]


def test_colours_are_logarithms_of_the_ratio() -> None:
    mesh = plot_ert(ERT, Figure().subplots())
    ratios = np.ma.filled(np.ma.asarray(mesh.get_array()), np.nan)
    expected = [[0, np.log10(2)], [np.nan, 0], [np.log10(42), np.nan]]
    np.testing.assert_allclose(ratios, expected, atol=1e-12)


def test_the_last_line_is_the_cost_of_the_best_method() -> None:
    rows = ERT.assign(ert=ERT["ert"].where(ERT["problem"] == "b", np.inf))
    labels = [tick.get_text() for tick in drawn(rows).axes[0].get_xticklabels()]
    assert labels == ["100", "-"]


def test_an_unknown_factor_is_refused() -> None:
    with pytest.raises(ValueError, match=r"factor is 1.5; the frame has 1.01"):
        ert_table(ERT, factor=1.5)


@pytest.mark.parametrize(
    ("value", "text"),
    [(1, "1.0"), (9.94, "9.9"), (9.96, "10"), (999.4, "999"), (999.6, "1.0k"), (12_345, "12k"),
     (3.4e6, "3.4M"), (2e9, "2.0G"), (np.nan, "-")],
)  # fmt: skip
def test_short_numbers(value: float, text: str) -> None:
    assert short(value) == text


@pytest.mark.slow
def test_the_text_of_eighteen_problems_fits_its_cells() -> None:
    figure = ert_table(running_times(methods(22), 18))
    figure.draw_without_rendering()
    ax = figure.axes[0]
    width = ax.get_window_extent().width / 18
    texts = [text for text in ax.texts if text.get_text() != "mean rank"]
    assert len(texts) > 22 * 18
    assert max(text.get_window_extent().width for text in texts) < width
    everything = [text for text in figure.findobj(Text) if text.get_window_extent().width > 0]
    assert min(text.get_window_extent().x0 for text in everything) >= -1
    assert max(text.get_window_extent().y1 for text in everything) <= figure.bbox.y1 + 1
