"""The page is whole, escaped and self-contained; numbers keep the digits their errors leave."""

import math
import re
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from miho.analysis.figures.house import png
from miho.analysis.pages.run import Section, page
from miho.analysis.text import ends, scaled, to_error
from miho.figures.report import Column, fit_figure, profile_figure, residual_figure

x = np.linspace(-1, 1, 60)
alpha = Column("alpha", "rad", x)
force = Column("Fy", "N", -3 * x)


class Checker(HTMLParser):
    """Every tag that opens closes, in order."""

    void = ("meta", "img")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.seen.append(tag)
        if tag not in self.void:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_a_page_is_whole_and_loads_nothing() -> None:
    table = pd.DataFrame({"name": ["<B>", "C & D"], "value": ["1.5", "-"]})
    figure = fit_figure(force, force.values, alpha, (x, -3 * x, 0.1 + 0 * x))
    sections = [
        Section("Table", table=table, caption="a < b"),
        Section("Words", ["one <script>", "two"]),
        Section("Figure", figure=png(figure), caption="the fit"),
        Section("Nothing", table=pd.DataFrame()),
    ]
    html = page("A <title>", "sub", sections)
    checker = Checker()
    checker.feed(html)
    assert checker.open == []
    assert {"table", "img", "li", "h2", "p"} <= set(checker.seen)
    assert "script" not in checker.seen
    assert "&lt;B&gt;" in html
    assert "C &amp; D" in html
    assert "a &lt; b" in html
    assert not re.search(r"(src|href)=\"(?!data:)", html)
    assert "://" not in html
    assert "default-src 'none'" in html
    assert "unsafe" not in html


def test_figures_say_what_their_axes_are() -> None:
    def labels(figure: Figure) -> list[str]:
        return [text for ax in figure.axes for text in (ax.get_xlabel(), ax.get_ylabel())]

    assert labels(fit_figure(force, -3 * x, alpha, (x, -3 * x, 0 * x))) == ["alpha [rad]", "Fy [N]"]
    assert labels(fit_figure(force, -3 * x, None, None))[0] == "predicted Fy [N]"
    errors = Column("error", "N", np.sin(9 * x))
    columns = [alpha, Column("Fz", "N", x + 2), force, Column("gamma", "rad", x**2)]
    residuals = residual_figure(errors, columns)
    assert labels(residuals)[::2] == [column.label for column in columns]
    assert "error [N]" in labels(residuals)
    parts = {"left": x < 0, "right": x >= 0}
    legends = [residual_figure(errors, columns, parts).legends[0]]
    legends.append(fit_figure(force, -3 * x, None, None, parts).axes[0].get_legend())
    for legend in legends:
        assert legend is not None
        assert [text.get_text() for text in legend.get_texts()][:2] == ["left", "right"]
    profiles = dict.fromkeys("BCDE", (x, 2 * x))
    assert labels(profile_figure(profiles, dict.fromkeys("BCDE", "-"), 1.96))[0] == "B [-]"


@pytest.mark.parametrize(
    ("value", "error", "expected"),
    [
        (76719.1, 3038.8, "76719"),
        (17.3501, 1.3240, "17.4"),
        (0.0074003, 0.00083, "0.00740"),
        (1.66506, 0.0607, "1.665"),
        (2.49412e-6, 3.51e-9, "2.4941e-06"),
        (3.51e-9, 3.51e-9, "3.5e-09"),
        (0.0, 3.51e-9, "0.0e+00"),
        (3.0, math.nan, "3"),
        (3e3, 2.5e-14, "3000"),
        (77.34930234266113, 2.2e-15, "77.34930234"),
        (math.inf, 0.1, "inf"),
        (math.nan, 0.1, "-"),
    ],
)
def test_digits_follow_the_error(value: float, error: float, expected: str) -> None:
    assert to_error(value, error) == expected


def test_few_rows_are_drawn_larger() -> None:
    many = np.linspace(-1, 1, 2000)
    few = fit_figure(force, -3 * x, None, None).axes[0].collections[0]
    dense = fit_figure(Column("Fy", "N", many), many, None, None).axes[0].collections[0]
    assert few.get_sizes() == 16
    assert dense.get_sizes() == 4


def test_units_and_intervals() -> None:
    assert scaled(76719.1, "N/rad") == (1e-3, "kN/rad")
    assert scaled(300.0, "N") == (1.0, "N")
    assert scaled(np.pi, "rad") == (180 / np.pi, "deg")
    assert scaled(-2e6, "Pa") == (1e-3, "kPa")
    assert scaled(math.nan, "N") == (1.0, "N")
    assert ends(1.0, 2.0, 0.25) == "[1.00, 2.00]"
    assert ends(math.nan, math.nan, 1.0) == "-"
    assert ends(-math.inf, 2.0, 0.25) == "[open, 2.00]"
    assert ends(-math.inf, math.inf, math.inf) == "[-inf, inf]"
