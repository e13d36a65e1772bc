"""The page of a report in headless Chromium: every table is whole on paper and on a phone."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from miho.analysis.pages.run import Section, page
from tests.chromium import Page, browser, chromium

PATH = browser()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(PATH is None, reason="there is no Chromium or Chrome on this machine"),
]
PAPER = 680
"""CSS pixels of the 180 mm between the margins of A4."""
CUT = """[...document.querySelectorAll('table')].flatMap(table => {
  const room = table.parentElement.getBoundingClientRect().right;
  return [...table.querySelectorAll('th, td')]
    .filter(cell => cell.getBoundingClientRect().right > room + 1 ||
                    cell.scrollWidth > cell.clientWidth + 1)
    .map(cell => cell.textContent);
})"""
"""The cells that end beyond the box that their table scrolls in, or hold more than is shown."""

PARAMETERS = pd.DataFrame(
    [[name, "-0.00499", "1/rad", "0.00022", "[-0.00542, -0.00457]", "[-0.00542, -0.00457]"]
     for name in ("B", "C", "D", "Sx", "Sy")],
    columns=["parameter", "value", "unit", "standard error", "linearised", "profile"],
)  # fmt: skip
DERIVED = pd.DataFrame(
    [["mean peak force over the median load, 2616 N", "1.6745 ± 0.0048", "kN/rad",
      "[1.6651, 1.6839]"]] * 3,
    columns=["derived", "value", "unit", "95 % interval (linearised)"],
)  # fmt: skip
ORIGIN = pd.DataFrame({"what": ["code", "run"], "value": ["c0eaed3b" * 8, "/a/path" * 20]})
CORRELATION = pd.DataFrame(np.full((27, 28), "-0.94"), columns=["", *(f"PY{n}" for n in range(27))])


@pytest.fixture(scope="module")
def tab() -> Iterator[Page]:
    assert PATH
    with chromium(PATH) as opened:
        yield opened


def written(folder: Path, *tables: pd.DataFrame) -> Path:
    path = folder / "report.html"
    sections = [Section(f"Table {number}", table=table) for number, table in enumerate(tables)]
    path.write_text(page("A report", "of a test", sections), encoding="utf-8")
    return path


def test_paper_shows_every_cell_and_no_scroll_bar(tab: Page, tmp_path: Path) -> None:
    path = written(tmp_path, PARAMETERS, DERIVED, ORIGIN, CORRELATION)
    tab.call("Emulation.setEmulatedMedia", media="print")
    try:
        tab.open(path, PAPER)
        assert tab.run(CUT) == []
        overflow = (
            "[...document.querySelectorAll('.scroll')].map(e => getComputedStyle(e).overflowX)"
        )
        assert set(tab.run(overflow)) == {"visible"}
    finally:
        tab.call("Emulation.setEmulatedMedia", media="")


@pytest.mark.parametrize("width", [375, 412])
def test_a_phone_shows_values_and_intervals_beside_the_names(
    tab: Page, tmp_path: Path, width: int
) -> None:
    tab.open(written(tmp_path, PARAMETERS, DERIVED, ORIGIN), width)
    assert tab.run(CUT) == []
    assert tab.run("document.documentElement.scrollWidth") <= width


def test_a_table_too_wide_for_a_phone_scrolls_beside_its_names(tab: Page, tmp_path: Path) -> None:
    tab.open(written(tmp_path, CORRELATION), 375)
    assert tab.run("document.documentElement.scrollWidth") <= 375
    assert tab.run("parseFloat(getComputedStyle(document.querySelector('td')).fontSize)") >= 10
    tab.run("document.querySelector('.scroll').scrollLeft = 500")
    assert tab.run(
        "document.querySelector('tbody th').getBoundingClientRect().left"
    ) == pytest.approx(
        tab.run("document.querySelector('.scroll').getBoundingClientRect().left"), abs=1
    )
