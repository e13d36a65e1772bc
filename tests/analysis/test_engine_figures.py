"""Fig. 5: what is drawn is what was given."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from matplotlib.collections import PathCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text

from miho.analysis.figures.engine import fig5

RPM = np.linspace(1000, 7000, 13)
THROTTLE = np.array([0.0, 5.0, 15.0, 30.0, 100.0])


def arguments() -> dict[str, Any]:
    """Straight curves of 10 Nm per percent at 5 and 15 %, learned from 2000 to 6000 rpm."""
    learned = np.zeros((5, 13))
    learned[1:3, 2:11] = 1.0
    curves = {p: (RPM, 10 * p - RPM / 100) for p in (5.0, 15.0)}
    return {
        "samples": {p: (rpm + 10, torque + 3) for p, (rpm, torque) in curves.items()},
        "curves": curves,
        "rpm": RPM,
        "throttle": THROTTLE,
        "torque": 5 * THROTTLE[:, None] - RPM / 100,
        "learned": learned,
    }


@pytest.fixture(scope="module")
def figure() -> Figure:
    data = arguments()
    note = "torque from a simulated drive, " * 9
    return fig5(**data, truth=data["curves"], errors={5.0: 4.96}, note=note)


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.findobj(Text) if isinstance(text, Text)]


def test_the_left_panel_shows_samples_and_curves_in_one_colour_each(figure: Figure) -> None:
    data, left = arguments(), figure.axes[0]
    points = [c for c in left.collections if isinstance(c, PathCollection)]
    assert len(points) == 2
    lines = [line for line in left.lines if "%" in line.get_label()]
    assert [line.get_label() for line in lines] == ["5 %, error 5.0 Nm", "15 %"]
    for percent, drawn, line in zip((5.0, 15.0), points, lines, strict=True):
        np.testing.assert_array_equal(np.array(drawn.get_offsets()).T, data["samples"][percent])
        np.testing.assert_array_equal(np.array(line.get_data()), data["curves"][percent])
        assert np.allclose(drawn.get_facecolor()[0][:3], to_rgb(line.get_color()))
    assert left.get_xlabel() == "engine speed [rpm]"
    assert left.get_ylabel() == "engine torque [Nm]"


def test_what_is_not_given_is_not_named(figure: Figure) -> None:
    assert texts(figure).count("true") == 1
    assert "dyno" not in texts(figure)
    data = arguments()
    named = texts(fig5(**data, dyno=data["samples"]))
    assert named.count("dyno") == 1
    assert "true" not in named


def test_the_right_panel_shades_where_the_learned_curves_are_used(figure: Figure) -> None:
    """From the row below the first to the row above the last, and the speeds beside them."""
    right = figure.axes[1]
    boxes = [c.get_datalim(right.transData) for c in right.collections]
    low, high = boxes[0].min, boxes[0].max
    assert low == pytest.approx([1500, 0], abs=1)
    assert high == pytest.approx([6500, 30], abs=0.1)
    rows = [np.array(line.get_data()) for line in right.lines]
    assert [row[1][0] for row in rows] == [5, 15]
    assert all((row[0].min(), row[0].max()) == (2000, 6000) for row in rows)
    assert right.get_ylabel() == "throttle [%]"


def test_the_contours_carry_their_torque(figure: Figure) -> None:
    labels = {text for text in texts(figure) if text.isdigit()}
    assert {"100", "200", "300", "400"} <= labels
    assert any("interpolated with" in text for text in texts(figure))


def test_a_table_of_the_wrong_shape_is_refused() -> None:
    data = arguments()
    with pytest.raises(ValueError, match="torque of the map has shape"):
        fig5(**(data | {"torque": data["torque"].T}))


def test_a_note_stays_on_the_page(figure: Figure) -> None:
    (caption,) = (t for t in figure.findobj(Text) if "simulated" in t.get_text())
    box = caption.get_window_extent()
    assert box.x1 <= figure.bbox.x1
    assert box.y0 >= figure.bbox.y0
