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
         "e_psi", "u_throttle", "u_brake", "planned_use")  # fmt: skip
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


def test_fig7_shows_the_log() -> None:
    figure = fig7(LOG, obstacle=2.0, note="a note")
    velocity, lateral, steering, friction = figure.axes
    assert curve(velocity, "driven") == pytest.approx(LOG["vx"])
    assert curve(velocity, "desired") == pytest.approx(LOG["v_des"])
    assert curve(lateral, "driven") == pytest.approx(LOG["ay"])
    assert curve(lateral, "limit") == pytest.approx(LOG["ay_limit"])
    assert curve(steering, "command") == pytest.approx(np.degrees(LOG["u_steering"]))
    assert curve(friction, "driven") == pytest.approx(LOG["planned_use"])
    assert [line.get_xdata()[0] for line in steering.get_lines()][-1] == 2.0
    assert figure.get_suptitle() == ""
    no_overlap(figure)


def test_fig7_shows_in_red_where_the_car_exceeds_the_plan() -> None:
    """In the panels of the acceleration and of the friction, there alone, and says it above."""
    beyond = np.zeros(N, dtype=bool)
    beyond[10:15] = True
    log = LOG.assign(planned_use=np.where(beyond, 1.2, 0.8))
    figure = fig7(log, excess="for 0.50 s, by up to 20 %")
    _, lateral, _, friction = figure.axes
    for ax, column in ((lateral, "ay"), (friction, "planned_use")):
        red = curve(ax, "beyond the plan")
        assert (np.isfinite(red) == beyond).all()
        assert red[beyond] == pytest.approx(log[column][beyond])
    assert figure.get_suptitle() == "red: beyond the planned friction for 0.50 s, by up to 20 %"
    no_overlap(figure)
    within = fig7(LOG).axes[1]
    assert all(line.get_label() != "beyond the plan" for line in within.get_lines())


@pytest.mark.parametrize(
    ("figure", "at"),
    [
        (fig7(LOG, departure=(2.5, "the car left the road")), 2.5),
        (fig8(LOG, departure=(450.0, "the car left the road")), 0.45),
    ],
)
def test_a_car_that_left_the_road_is_seen_in_every_panel(figure: Figure, at: float) -> None:
    assert figure.get_suptitle() == "red line: the car left the road"
    for ax in figure.axes:
        assert any(np.allclose(np.asarray(line.get_xdata()), at) for line in ax.get_lines())
    no_overlap(figure)


def test_fig8_shows_errors_over_the_distance() -> None:
    log = LOG.assign(vx=np.linspace(30.0, 60.0, N), v_des=np.linspace(30.2, 59.5, N))
    figure = fig8(log, laps=[0.0, 450.0])
    position, heading, velocity, error, pedals = figure.axes
    assert position.get_lines()[0].get_xdata() == pytest.approx(log["distance"] / 1000)
    assert heading.get_lines()[0].get_ydata() == pytest.approx(np.degrees(log["e_psi"]))
    largest = np.degrees(log["e_psi"].max())
    assert heading.get_title(loc="right") == f"largest {largest:.2f} deg"
    assert curve(velocity, "driven") == pytest.approx(log["vx"])
    assert error.get_lines()[0].get_ydata() == pytest.approx(log["vx"] - log["v_des"])
    assert curve(pedals, "brake [bar]") == pytest.approx(log["u_brake"] / 1e5)
    assert pedals.get_xlabel() == "distance [km]"
    no_overlap(figure)


def test_the_desired_velocity_is_seen_under_the_driven_one() -> None:
    velocity = fig8(LOG).axes[2]
    lines = {str(line.get_label()): line for line in velocity.get_lines()}
    assert lines["desired"].get_linewidth() > 2 * lines["driven"].get_linewidth()
    assert lines["desired"].get_zorder() <= lines["driven"].get_zorder()


def test_the_bands_of_the_paper_are_shaded_where_the_car_drives_in_them() -> None:
    """Above 40 m/s from a third of the way on, and 42 to 52 m/s for a third of it."""
    log = LOG.assign(vx=np.linspace(30.0, 60.0, N))
    error = fig8(log).axes[3]
    above, middle = (band.get_datalim(error.transData) for band in error.collections)
    step = 900.0 / (N - 1) / 1000
    assert (above.x0, above.x1) == (pytest.approx(0.3, abs=step), pytest.approx(0.9, abs=step))
    assert (middle.x0, middle.x1) == (pytest.approx(0.36, abs=step), pytest.approx(0.66, abs=step))
    names = [text.get_text() for text in error.get_legend().get_texts()]
    assert names == ["above 40 m/s (144 km/h)", "42-52 m/s (151-187 km/h)"]
