"""The table and the figure of laps over seeds."""

import math

import numpy as np
import pandas as pd
import pytest

from miho.analysis.figures.driving import MEASURES, lap_figure, lap_table, lap_text


@pytest.fixture
def laps() -> pd.DataFrame:
    """Two variants over five seeds; the second one never finishes, the first fails once."""
    rng = np.random.default_rng(0)
    rows = []
    for variant in ("good", "bad"):
        for seed in range(5):
            row = {"variant": variant, "seed": seed}
            row |= {column: 1 + 0.1 * rng.random() for column in MEASURES}
            if variant == "bad" or seed == 4:
                row["lap_time"] = math.nan
            rows.append(row)
    return pd.DataFrame(rows)


def test_means_are_of_finished_laps_in_the_shown_unit(laps: pd.DataFrame) -> None:
    table = lap_table(laps, np.random.default_rng(0)).set_index("variant")
    good = laps[(laps["variant"] == "good") & laps["lap_time"].notna()]
    assert table.loc["good", "finished"] == 4
    assert table.loc["good", "seeds"] == 5
    assert table.loc["good", "e_psi"] == pytest.approx(math.degrees(good["e_psi"].mean()))
    assert table.loc["good", "margin"] == pytest.approx(100 * good["margin"].mean())
    assert table.loc["good", "e_y_low"] <= table.loc["good", "e_y"] <= table.loc["good", "e_y_high"]
    assert table.loc["bad", "finished"] == 0
    assert math.isnan(table.loc["bad", "e_y"])


def test_the_interval_is_that_of_the_mean() -> None:
    """Of 400 normal values the percentile bootstrap gives the mean +- 1.96 s / sqrt(n).

    The tolerance, 12 % of that reach, is four times what 2000 resamples scatter.
    """
    values = np.random.default_rng(1).standard_normal(400)
    laps = pd.DataFrame({"variant": "one", "seed": range(400), **dict.fromkeys(MEASURES, values)})
    row = lap_table(laps, np.random.default_rng(2)).iloc[0]
    reach = 1.96 * values.std(ddof=1) / 20
    assert row["lap_time_low"] == pytest.approx(values.mean() - reach, abs=0.12 * reach)
    assert row["lap_time_high"] == pytest.approx(values.mean() + reach, abs=0.12 * reach)


def test_the_text_says_what_did_not_finish(laps: pd.DataFrame) -> None:
    lines = lap_text(lap_table(laps, np.random.default_rng(0))).splitlines()
    assert "0 of 5" in lines[2]
    assert lines[2].split()[-1] == "-"
    assert "4 of 5" in lines[1]


def test_the_figure_has_a_panel_for_each_measure(laps: pd.DataFrame) -> None:
    table = lap_table(laps, np.random.default_rng(0))
    figure = lap_figure(laps, table, note="a note")
    assert len(figure.axes) == len(MEASURES)
    for ax, column in zip(figure.axes, MEASURES, strict=True):
        means = [line.get_xdata()[0] for line in ax.lines if len(line.get_xdata()) == 1]
        assert means == [pytest.approx(table[column][0])]
        assert [text.get_text() for text in ax.texts] == ["-"]
