"""The figures of one report."""

import numpy as np
import pytest
from numpy.typing import NDArray

from miho.figures.report import waterfall_figure


def legend_of(
    errors: list[float], here: int, known: float | None = None
) -> tuple[list[str], str, NDArray[np.float64]]:
    """Texts of the legend, scale of the axis, and the points that are drawn (n, 2)."""
    ended_here = np.arange(len(errors)) < here
    figure = waterfall_figure(np.array(errors), ended_here, "N", known, 1e-8)
    (ax,) = figure.axes
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    points = np.concatenate([np.asarray(part.get_offsets()) for part in ax.collections])
    low, high = ax.get_ylim()
    drawn = np.append(points[:, 1], [] if known is None else max(known, 1e-8))
    assert ((low < drawn) & (drawn < high)).all(), "nothing is cut"
    return texts, ax.get_yscale(), points


def test_a_waterfall_counts_the_descents_that_agree() -> None:
    texts, scale, points = legend_of([391.3, 391.3, 391.4, 738.8, 783.2], 2, 391.3)
    assert texts == ["ended here: 2", "elsewhere: 3", "best known optimum"]
    assert scale == "linear"
    assert points.tolist() == [[1, 391.3], [2, 391.3], [3, 391.4], [4, 738.8], [5, 783.2]]


def test_a_waterfall_counts_what_has_no_error() -> None:
    here = np.array([True, True, False])
    figure = waterfall_figure(np.array([2.0, 2.0, 3.0]), here, "N", None, 0.0, "brackets", 4)
    (ax,) = figure.axes
    assert ax.get_xlabel() == "brackets, the best first"
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts == ["ended here: 2", "elsewhere: 1", "dropped on fewer rows: 4"]
    assert sum(len(np.asarray(part.get_offsets())) for part in ax.collections) == 3


@pytest.mark.parametrize(
    ("errors", "here", "known", "scale", "texts"),
    [
        ([2.0, 2.0], 2, None, "linear", ["ended here: 2"]),
        ([2.0, 2.0, 3.0], 0, None, "linear", ["elsewhere: 3"]),
        ([2.0, 2.0, 11.0], 2, None, "log", ["ended here: 2", "elsewhere: 1"]),
        ([2.0, 3.0], 1, 0.3, "log", ["ended here: 1", "elsewhere: 1", "best known optimum"]),
        ([0.0, 1e-13, 5.0], 2, 0.0, "log", ["ended here: 2", "elsewhere: 1", "best known optimum"]),
    ],
)
def test_its_axis_fits_the_errors(
    errors: list[float], here: int, known: float | None, scale: str, texts: list[str]
) -> None:
    assert legend_of(errors, here, known)[:2] == (texts, scale)
