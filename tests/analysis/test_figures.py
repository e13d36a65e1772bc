from __future__ import annotations

from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text
from numpy.typing import NDArray

from miho.analysis.compare.size import chosen
from miho.analysis.figures.house import save, spread_apart
from miho.analysis.figures.paper import fig4, fig6, plot_error_over
from miho.analysis.styles import STYLES, distinct, styles_of
from tests.analysis.synthetic import frames, like_fig6


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.findobj(Text) if isinstance(text, Text)]


def test_the_drawn_line_is_the_mean_in_kn() -> None:
    _, curves = frames({"miho": [[(1.0, 3000.0), (10.0, 400.0)], [(2.0, 1000.0), (10.0, 600.0)]]})
    ax = Figure().subplots()
    plot_error_over(curves, "evaluations", ax, grid=np.array([1.0, 2.0, 9.9, 10.0, 1e6]))
    np.testing.assert_allclose(np.asarray(ax.lines[0].get_ydata()), [np.nan, 2, 2, 0.5, 0.5])
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert ax.get_ylabel() == "error [kN]"


def test_beyond_its_end_a_method_goes_on_thin() -> None:
    _, curves = frames({"miho": [[(1.0, 400.0)]], "random": [[(1.0, 900.0)]]}, ends={"miho": 10.0})
    ax = Figure().subplots()
    plot_error_over(curves, "evaluations", ax, grid=np.array([1.0, 10.0, 100.0, 1e6]))
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), [1, 10])
    np.testing.assert_array_equal(ax.lines[1].get_xdata(), [10, 100, 1e6])
    assert ax.lines[1].get_linewidth() < ax.lines[0].get_linewidth()


def test_an_improvement_at_the_end_of_a_run_is_drawn_as_its_own() -> None:
    steps = {"miho": [[(1.0, 900.0), (40.0, 400.0)]], "random": [[(1.0, 900.0)]]}
    _, curves = frames(steps, ends={"miho": 40.0})
    ax = Figure().subplots()
    plot_error_over(curves, "evaluations", ax, grid=np.array([1.0, 10.0, 100.0, 1e6]))
    np.testing.assert_allclose(np.asarray(ax.lines[0].get_ydata()), [0.9, 0.9, 0.4])
    np.testing.assert_allclose(np.asarray(ax.lines[1].get_ydata()), [0.4, 0.4])


def test_fig6_names_each_method_once_with_its_final_error_and_colour() -> None:
    runs, curves = like_fig6(3)
    figure = fig6(runs, curves, note="reduced size: R = 625")
    written = texts(figure)
    for method, errors in runs.groupby("optimizer")["error"]:
        label = [text for text in written if text.endswith(f"  {STYLES[str(method)].name}")]
        assert len(label) == 1
        assert float(label[0].split()[0]) == pytest.approx(errors.mean() / 1e3, rel=0.01, abs=5e-3)
    assert any("R\u00a0=\u00a0625" in text for text in written)
    (small,) = (text for text in written if text.startswith("lines: mean"))
    assert "irreducible error, 0.38 to 0.40 kN" in small.replace("\n", " ")


def test_fig6_says_which_method_has_fewer_runs() -> None:
    runs, curves = like_fig6(3)
    runs, curves = (frame[frame["id"] != "miho-1"] for frame in (runs, curves))
    counted = [text for text in texts(fig6(runs, curves)) if text.endswith(" of 3)")]
    assert [text[4:] for text in counted] == ["  MIHO (2 of 3)"]


@pytest.mark.parametrize(("end", "plain"), [(20.0, True), (44.0, True), (1e4, False)])
def test_labels_of_a_short_axis_are_plain_numbers_and_do_not_overlap(
    end: float, plain: bool
) -> None:
    _, curves = frames({"miho": [[(1.0, 900.0), (end, 400.0)]]})
    figure = Figure(figsize=(3, 2))
    ax = figure.subplots()
    plot_error_over(curves, "evaluations", ax, grid=np.geomspace(1, end))
    figure.draw_without_rendering()
    shown = [text for text in ax.get_xticklabels(which="both") if text.get_text()]
    assert ("5" in [text.get_text() for text in shown]) == plain
    visible = [text for text in shown if ax.get_xlim()[0] <= text.get_position()[0] <= end]
    boxes = sorted((text.get_window_extent() for text in visible), key=lambda box: box.x0)
    assert all(one.x1 < other.x0 for one, other in pairwise(boxes))


def test_fig6_has_its_labels_beside_the_papers_panel_and_no_text_among_the_curves() -> None:
    figure = fig6(*like_fig6(3))
    over_time, over_evaluations = figure.axes
    assert len(over_time.texts) == 8
    assert all(label.get_position()[0] > 1 for label in over_time.texts)
    assert not over_evaluations.texts
    assert (over_time.get_xlabel(), over_evaluations.get_xlabel()) == (
        "time [s]", "evaluations of the full loss",
    )  # fmt: skip


def test_the_papers_methods_can_be_chosen() -> None:
    present = list(like_fig6(2)[0]["optimizer"].unique())
    paper = {"miho", "gbo_small", "gbo_large", "pso_100", "pso_500", "optuna_hyperband"}
    assert set(chosen(present, "paper")) == paper
    assert list(chosen(present, ["miho", "random"])) == ["miho", "random"]
    with pytest.raises(ValueError, match="no runs of pso_9; expected paper or some of gbo_large"):
        chosen(present, ["miho", "pso_9"])


def test_fig6_draws_runs_of_other_settings_as_other_methods() -> None:
    runs, curves = frames({"miho": [[(1.0, 400.0)], [(1.0, 600.0)], [(1.0, 900.0)]]})
    R = {"miho-0": 300, "miho-1": 1000, "miho-2": 1000}
    runs["seed"], curves["seed"] = [0, 0, 1], curves["id"].map({"miho-0": 0, "miho-1": 0}).fillna(1)
    runs["optimizer.R"], curves["optimizer.R"] = runs["id"].map(R), curves["id"].map(R)
    labels = {label.get_text() for label in fig6(runs, curves).axes[0].texts}
    assert labels == {"0.40  MIHO R=300 (1 of 2)", "0.75  MIHO R=1000"}


FULL_COMPARISON = (
    "miho_gn", "miho", "gbo_small", "gbo_large", "pso_100", "pso_500", "optuna_hyperband", "random",
    "least_squares",
)  # fmt: skip
DEUTERANOPIA = [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]]
"""Machado, Oliveira and Fernandes (2009), severity 1, on linear RGB."""


def lab(color: str, seen: list[list[float]]) -> NDArray[np.float64]:
    """CIE L*a*b* of a colour (D65), as it is seen through a matrix on linear RGB."""
    rgb = np.array(to_rgb(color))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    xyz = np.array(to_xyz) @ np.clip(np.array(seen) @ linear, 0, 1) / [0.9505, 1.0, 1.089]
    x, y, z = np.where(xyz > 216 / 24389, np.cbrt(xyz), xyz * 841 / 108 + 4 / 29)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


@pytest.mark.parametrize("seen", [np.eye(3).tolist(), DEUTERANOPIA], ids=["all", "deuteranopia"])
def test_nine_methods_have_nine_hues_that_can_be_told_apart(seen: list[list[float]]) -> None:
    """Some 2 units of L*a*b* are just noticed side by side; lines apart need several times that."""
    styles = distinct(FULL_COMPARISON).values()
    assert len({style.color for style in styles}) == 9
    colors = [lab(style.color, seen) for style in styles]
    gaps = [float(np.linalg.norm(a - b)) for a, b in combinations(colors, 2)]
    assert min(gaps) > 15


def test_more_methods_than_hues_keep_their_dashes() -> None:
    looks = [(s.color, s.dashes) for s in distinct([f"miho R={R}" for R in range(14)]).values()]
    assert len(set(looks)) > 11


def test_fig6_of_disturbed_runs_is_whole_and_says_whose_seconds_it_shows() -> None:
    runs, curves = like_fig6(3)
    quiet = fig6(runs.assign(timing_valid=True), curves)
    assert quiet.axes[0].get_xlabel() == "time [s]"
    figure = fig6(runs.assign(timing_valid=[False] * 23 + [True]), curves)
    left = figure.axes[0]
    label = left.get_xlabel().replace("\n", " ")
    assert label == "CPU seconds (other work disturbed 23 of 24 runs)"
    lines = {line.get_label(): line for line in left.get_lines()}
    names = {style.name for style in styles_of(runs["optimizer"]).values()}
    assert names <= set(lines)
    at = np.asarray(lines["MIHO"].get_xdata())
    of_miho = curves[curves["optimizer"] == "miho"]
    assert at.max() <= of_miho["cpu_seconds"].max() < of_miho["seconds"].max()


def test_fig6_of_a_method_without_undisturbed_runs_is_drawn_over_evaluations() -> None:
    runs, curves = like_fig6(3)
    runs = runs[(runs["optimizer"] != "random") | (runs["seed"] == 2)]
    figure = fig6(runs.assign(timing_valid=runs["seed"] < 2), curves[curves["id"].isin(runs["id"])])
    names = [{line.get_label() for line in ax.get_lines()} for ax in figure.axes]
    assert names[1] - names[0] >= {STYLES["random"].name}


@pytest.mark.slow
def test_fig6_labels_neither_overlap_nor_leave_the_page() -> None:
    figure = fig6(*like_fig6(3))
    figure.draw_without_rendering()
    names = tuple(style.name for style in STYLES.values())
    labels = [
        t for t in figure.findobj(Text) if isinstance(t, Text) and t.get_text().endswith(names)
    ]
    boxes = sorted((label.get_window_extent() for label in labels), key=lambda box: box.y0)
    assert len(boxes) == 8
    for below, above in pairwise(boxes):
        assert below.y1 <= above.y0 + 1
    assert max(box.x1 for box in boxes) <= figure.bbox.x1
    assert all(float(label.get_fontsize()) >= 8 for label in labels)


def test_long_labels_leave_the_panel_wide() -> None:
    runs, curves = frames({"miho": [[(1.0, 400.0)]], "random": [[(1.0, 900.0)]]})
    for frame in (runs, curves):
        frame["optimizer"] = frame["optimizer"] + " seconds=0.5, points=50, code=8c5dac"
    figure = fig6(runs, curves)
    figure.draw_without_rendering()
    assert figure.axes[0].get_position().width > 0.4


@pytest.mark.slow
def test_a_long_caption_stays_on_the_page() -> None:
    note = "R = 2000, 5 repetitions, at most 4 s per run, " * 4
    figure = fig6(*like_fig6(3), note=note)
    figure.draw_without_rendering()
    (caption,) = (t for t in figure.findobj(Text) if "repetitions, at most" in t.get_text())
    box = caption.get_window_extent()
    assert box.x1 <= figure.bbox.x1
    assert box.y0 >= figure.bbox.y0
    assert all(box.y1 < ax.get_tightbbox().y0 + 1 for ax in figure.axes)


def test_fig6_says_when_a_mean_is_undefined() -> None:
    figure = fig6(*frames({"miho": [[(1.0, 400.0)]] * 2, "gbo_large": [[(1.0, 900.0)], []]}))
    assert "-  GBO-large" in texts(figure)
    assert "0.40  MIHO" in texts(figure)


def test_fig6_shows_the_digits_of_small_errors() -> None:
    steps = {"miho": [[(1.0, 9.48e-5)]] * 2, "pso_100": [[(1.0, 0.0166)]] * 2}
    written = texts(fig6(*frames(steps, unit="m", irreducible=(7.03e-5, 9.9e-5))))
    assert "9.48e-05  MIHO" in written
    assert "0.0166  PSO-100" in written
    assert any("7.03e-05 to 9.90e-05 m" in text.replace("\n", " ") for text in written)


def test_fig6_refuses_two_problems() -> None:
    runs, curves = frames({"miho": [[(1.0, 400.0)]] * 2})
    with pytest.raises(ValueError, match="one problem at a time"):
        fig6(runs.assign(problem=["a", "b"]), curves)


def test_styles_tell_methods_apart_and_stay_the_same() -> None:
    looks = [
        (style.color, style.dashes) for style in styles_of([*STYLES, "tpe_variant", "tpe"]).values()
    ]
    assert len(set(looks)) == len(STYLES) + 2
    assert styles_of(["random", "miho"])["miho"] == styles_of(["miho"])["miho"]
    assert styles_of(["tpe_variant"])["tpe_variant"].name == "tpe variant"


def test_spread_moves_only_what_is_too_close() -> None:
    np.testing.assert_allclose(spread_apart(np.array([0.9, 0.1]), 0.2), [0.9, 0.1])
    np.testing.assert_allclose(spread_apart(np.array([0.5, 0.5]), 0.2), [0.4, 0.6])
    np.testing.assert_allclose(spread_apart(np.array([0.0, 0.0, 0.0]), 0.2), [0, 0.2, 0.4])
    np.testing.assert_allclose(spread_apart(np.ones(11), 0.5), np.linspace(0, 1, 11), atol=1e-12)


def test_fig4_shows_samples_curves_and_errors() -> None:
    alpha = np.linspace(-12, 12, 300)
    tires = {tire: (alpha, -np.tanh(alpha)) for tire in ("LF", "RF", "LR", "RR")}
    figure = fig4(tires, tires, errors={"LF": 0.39}, note="3000 samples")
    assert "left front, error 0.39 kN" in texts(figure)
    assert "right rear" in texts(figure)
    for ax in figure.axes:
        assert len(ax.collections) == 2
        assert all(points.get_rasterized() for points in ax.collections)
        assert ax.get_xlabel() == "slip angle [deg]"


def test_fig4_refuses_unknown_tires() -> None:
    with pytest.raises(ValueError, match="tires XX are unknown"):
        fig4({"XX": (np.zeros(1), np.zeros(1))}, {})


def test_save_writes_both_formats_and_makes_the_folder(tmp_path: Path) -> None:
    figure = fig6(*frames({"miho": [[(1.0, 400.0)]]}))
    paths = save(figure, tmp_path / "figures" / "fig6.v1")
    assert [path.name for path in paths] == ["fig6.v1.png", "fig6.v1.pdf"]
    assert paths[0].read_bytes().startswith(b"\x89PNG")
    assert paths[1].read_bytes().startswith(b"%PDF")
