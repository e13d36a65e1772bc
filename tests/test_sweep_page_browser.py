"""The page of a sweep in headless Chromium: it opens, answers and fits, without a complaint."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from miho.analysis.pages.sweep import Best, sweep_page
from miho.analysis.pages.sweep_contents import Contents
from miho.analysis.styles import STYLES
from tests.analysis.sweep_synthetic import sweep_of
from tests.analysis.synthetic import like_fig6
from tests.chromium import Page, browser, chromium

PATH = browser()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(PATH is None, reason="there is no Chromium or Chrome on this machine"),
]
LINES = "document.querySelectorAll('#plot .curves_marks path').length"
COLORS = (
    "[...document.querySelectorAll('#plot .curves_marks path')].map(e => e.getAttribute('stroke'))"
)
LABELS = "[...document.querySelectorAll('#plot .role-axis-title text')].map(e => e.textContent)"
TICKS = "[...document.querySelectorAll('#plot .role-axis-label text')].map(e => e.textContent)"
VALUES = "[...document.querySelectorAll('#legend .value')].map(e => e.textContent)"
PRESSED = "document.activeElement.getAttribute('aria-pressed')"
WIDTHS = "[document.documentElement.scrollWidth, document.documentElement.clientWidth]"

SETTLED = """new Promise(done => {
  const look = () => document.querySelector('#plot').getAttribute('aria-busy') === 'false'
    ? done() : requestAnimationFrame(look);
  look();
})"""
"""Until the chart is drawn."""

Opened = Callable[[int], Page]


def press(page: Page, selector: str) -> None:
    page.click(selector)
    page.run(SETTLED)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight methods, five seeds; no optimum of the second problem is recorded, the third's is 0."""
    runs, curves = like_fig6(seeds=5)
    tables = []
    for table in (runs, curves):
        second = table.assign(problem="other", id="o" + table["id"], error=2 * table["error"])
        third = table.assign(problem="exact", id="e" + table["id"])
        tables.append(pd.concat([table, second, third], ignore_index=True))
    runs, curves = tables
    runs.loc[runs["problem"] == "other", "timing_valid"] = False
    runs.loc[runs["problem"] != "other", "timing_valid"] = True
    values = pd.DataFrame({"parameter": ["B"], "value": ["17.4"], "unit": ["1/rad"]})
    wide = pd.DataFrame([["x" * 30] * 12], columns=[f"column {n}" for n in range(12)])
    contents = Contents("Runs of a test", [("Command", "python -m " + "x" * 80)], claims=wide,
                references={"pacejka-tire_lf": 391.4, "other": 782.8},
                unrecorded={"other"})  # fmt: skip
    page = tmp_path_factory.mktemp("page") / "report.html"
    best = {"pacejka-tire_lf": Best("miho", 0, values, ["a note"])}
    page.write_text(sweep_page(sweep_of(runs, curves), contents, best), encoding="utf-8")
    return page


@pytest.fixture(scope="module")
def tab() -> Iterator[Page]:
    assert PATH
    with chromium(PATH) as page:
        yield page


@pytest.fixture
def opened(tab: Page, path: Path) -> Iterator[Opened]:
    """Opens the page afresh; nothing may have been complained of in the end."""
    tab.complaints.clear()

    def at(width: int) -> Page:
        tab.open(path, width)
        tab.run(SETTLED)
        return tab

    yield at
    assert tab.complaints == []


def test_it_opens_at_once_and_names_its_axes(opened: Opened) -> None:
    page = opened(1280)
    assert page.run(LINES) == 8
    assert page.run(LABELS) == ["evaluations of the loss [-]", "error [kN]"]
    names = page.run("[...document.querySelectorAll('#legend .name')].map(e => e.textContent)")
    assert names[:2] == ["MIHO", "least squares"]
    runs = like_fig6(seeds=5)[0]
    final = runs["error"][runs["optimizer"] == "miho"].median() / 1000
    assert float(page.run(VALUES)[0]) == pytest.approx(final, rel=1e-5)  # five digits are shown
    assert page.run("performance.getEntriesByType('resource').length") == 0


def test_methods_toggle_by_pointer_and_by_keys(opened: Opened) -> None:
    page = opened(1280)
    press(page, "#legend li:nth-child(1) button")
    assert page.run(LINES) == 7
    assert STYLES["miho"].color not in page.run(COLORS)
    for key, count, pressed in ((" ", 8, "true"), (" ", 7, "false")):
        page.run("document.querySelector('#legend li:nth-child(1) button').focus()")
        page.press(key)
        page.run(SETTLED)
        assert (page.run(LINES), page.run(PRESSED)) == (count, pressed)
    press(page, "#none")
    assert page.run(LINES) == 0
    press(page, "#all")
    assert page.run(LINES) == 8


def test_the_name_of_a_row_leaves_a_phone_room_for_its_values(opened: Opened) -> None:
    page = opened(375)
    page.run("document.querySelectorAll('details').forEach(e => { e.open = true })")
    widths = page.run("[...document.querySelectorAll('tbody th')].map(e => e.offsetWidth)")
    assert len(widths) > 8
    assert max(widths) <= 0.45 * 375


def test_axes_switch(opened: Opened) -> None:
    page = opened(1280)
    logarithmic = page.run(TICKS)
    press(page, "[data-set=axis][data-to=seconds]")
    assert page.run(LABELS)[0] == "CPU seconds [s]"  # the runs of the other problem are disturbed
    assert page.run("document.querySelector('[data-to=seconds]').textContent") == "CPU seconds"
    press(page, "[data-set=x][data-to=linear]")
    assert page.run(TICKS)[0] == "0"
    press(page, "[data-set=y][data-to=linear]")
    linear = page.run(TICKS)
    assert linear != logarithmic
    press(page, "[data-set=quantity][data-to=gap]")
    assert page.run(LABELS)[1] == "gap to the best known error [-]"
    page.run("((picker) => { picker.value = 1;"
             "  picker.dispatchEvent(new Event('change', { bubbles: true })); })"
             "(document.querySelector('#problem'))")  # fmt: skip
    page.run(SETTLED)
    assert page.run(LABELS)[1] == "gap to the best of these runs [-]"
    assert page.run("document.querySelectorAll('[data-set=x][aria-pressed=true]').length") == 1


def test_bands_and_seeds(opened: Opened) -> None:
    page = opened(1280)
    press(page, "[data-set=mode][data-to=band]")
    assert page.run("document.querySelectorAll('#plot .bands_marks path').length") == 8
    press(page, "[data-set=mode][data-to=seeds]")
    assert page.run(LINES) == 40
    assert "NaN" not in page.run("document.querySelector('#plot').innerHTML")


def test_what_is_not_there_cannot_be_chosen(opened: Opened) -> None:
    page = opened(1280)
    press(page, "[data-set=quantity][data-to=gap]")
    page.run("(s => { s.value = '2'; s.dispatchEvent(new Event('change')) })"
             "(document.querySelector('#problem'))")  # fmt: skip
    page.run(SETTLED)
    assert page.run(LABELS) == ["evaluations of the loss [-]", "error [kN]"]
    assert page.run("document.querySelector('[data-to=gap]').disabled")


def test_the_pointer_reads_values(opened: Opened) -> None:
    page = opened(1280)
    at_the_end = page.run(VALUES)
    middle = page.middle("#plot")
    page.move(middle["x"], middle["y"])
    assert "after" in page.run("document.querySelector('#readout').textContent")
    assert page.run("document.querySelectorAll('#plot .cross_marks line').length") == 1
    values = page.run(VALUES)
    assert values != at_the_end
    position = int(page.run("document.querySelector('#plot').getAttribute('aria-valuenow')"))
    curve: dict[str, Any] = page.run(
        "(p => ({grid: p.grid, text: p.curves[0].median}))"
        "(JSON.parse(document.querySelector('#curves-0').textContent).axes.evaluations)"
    )
    before = [told for told in curve["text"].split(",")[: position + 1] if told]
    assert float(values[0].replace(",", "")) == float(before[-1])
    page.move(5, 5)
    assert page.run(VALUES) == at_the_end


def test_the_crosshair_moves_by_keys(opened: Opened) -> None:
    page = opened(1280)
    page.run("document.querySelector('#plot').focus()")
    last = int(page.run("document.activeElement.getAttribute('aria-valuemax')"))
    where = "Number(document.activeElement.getAttribute('aria-valuenow'))"
    for key, place in (("ArrowLeft", last - 1), ("ArrowRight", last), ("Home", 0), ("End", last)):
        page.press(key)
        assert page.run(where) == place
    page.press("Escape")
    assert page.run("document.querySelector('#readout').textContent").endswith("at the end")
    reached = []
    page.run("document.activeElement.blur()")
    for _ in range(40):
        page.press("Tab")
        reached.append(page.run("document.activeElement.id || document.activeElement.tagName"))
    assert {"problem", "plot", "BUTTON", "all", "A", "SUMMARY"} <= set(reached)


def test_what_is_slipped_in_does_not_run(tab: Page, path: Path, tmp_path: Path) -> None:
    slipped = tmp_path / "report.html"
    evil = "<script>document.title = 'evil'</script><img src='https://example.org/x.png'>"
    slipped.write_text(path.read_text(encoding="utf-8").replace("</main>", evil + "</main>"))
    tab.complaints.clear()
    tab.open(slipped, 1280)
    assert tab.run("document.title") == "Runs of a test"
    complaints = " ".join(tab.complaints)
    assert "inline script" in complaints
    assert "img-src" in complaints


@pytest.mark.parametrize("width", [1280, 768, 390, 320])
def test_it_fits(opened: Opened, width: int) -> None:
    page = opened(width)
    content, window = page.run(WIDTHS)
    assert content <= window
    box = page.run(
        "(b => [b.left, b.right])(document.querySelector('#plot svg').getBoundingClientRect())"
    )
    assert box[0] >= 0
    assert box[1] <= window
    if width < 500:
        heights = "Math.min(...[...document.querySelectorAll('button')].map(e => e.offsetHeight))"
        assert page.run(heights) >= 40, "a finger needs room"
