"""Figs. 7 and 8: what is drawn is what was logged."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from miho.analysis.figures.driving import fig7, fig8

N = 50
NAMES = ("distance", "vx", "v_des", "ay", "ay_plan", "ay_limit", "steering", "u_steering", "e_y",
         "e_psi", "u_throttle", "u_brake")  # fmt: skip
RNG = np.random.default_rng(0)
LOG = pd.DataFrame({name: RNG.uniform(0.1, 0.9, N) for name in NAMES}).assign(
    time=np.linspace(0.0, 5.0, N), distance=np.linspace(0.0, 900.0, N)
)


def curve(ax: Axes, label: str) -> np.ndarray:
    (labelled,) = [line for line in ax.get_lines() if line.get_label() == label]
    return np.asarray(labelled.get_ydata())


def no_overlap(figure: Figure) -> None:
    boxes = [ax.get_tightbbox() for ax in figure.axes]
    for above, below in pairwise(boxes):
        assert below.y1 <= above.y0 + 1


def test_fig7_shows_the_log_in_the_units_of_the_paper() -> None:
    figure = fig7(LOG, steering_ratio=15.0, obstacle=2.0, note="a note")
    velocity, lateral, steering = figure.axes
    assert curve(velocity, "driven") == pytest.approx(3.6 * LOG["vx"])
    assert curve(velocity, "desired") == pytest.approx(3.6 * LOG["v_des"])
    assert curve(lateral, "driven") == pytest.approx(LOG["ay"])
    assert curve(lateral, "limit") == pytest.approx(LOG["ay_limit"])
    assert curve(steering, "command") == pytest.approx(15 * np.degrees(LOG["u_steering"]))
    assert [line.get_xdata()[0] for line in steering.get_lines()][-1] == 2.0
    no_overlap(figure)


@pytest.mark.parametrize(
    ("figure", "at"),
    [
        (fig7(LOG, steering_ratio=15.0, departure=(2.5, "the car left the road")), 2.5),
        (fig8(LOG, departure=(450.0, "the car left the road")), 0.45),
    ],
)
def test_a_car_that_left_the_road_is_seen_in_every_panel(figure: Figure, at: float) -> None:
    assert figure.get_suptitle() == "red line: the car left the road"
    for ax in figure.axes:
        assert any(np.allclose(np.asarray(line.get_xdata()), at) for line in ax.get_lines())
    no_overlap(figure)


def test_fig8_shows_errors_over_the_distance() -> None:
    figure = fig8(LOG, laps=[0.0, 450.0])
    position, heading, velocity, pedals = figure.axes
    assert position.get_lines()[0].get_xdata() == pytest.approx(LOG["distance"] / 1000)
    assert heading.get_lines()[0].get_ydata() == pytest.approx(np.degrees(LOG["e_psi"]))
    largest = np.degrees(LOG["e_psi"].max())
    assert heading.get_title(loc="right") == f"largest {largest:.2f}"
    assert curve(velocity, "driven") == pytest.approx(3.6 * LOG["vx"])
    assert curve(pedals, "brake [bar]") == pytest.approx(LOG["u_brake"] / 1e5)
    assert pedals.get_xlabel() == "distance [km]"
    no_overlap(figure)
