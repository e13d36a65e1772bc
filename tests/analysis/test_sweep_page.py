"""The page of a sweep is whole, light, escaped and lets nothing in or out."""

from __future__ import annotations

import base64
import hashlib
import re
import sys
from collections.abc import Collection
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import pandas as pd
import pytest

from miho.analysis.pages.html import environment
from miho.analysis.pages.sweep import Best, sweep_page, vega
from miho.analysis.pages.sweep_contents import Contents
from tests.analysis.arena_synthetic import arena, methods
from tests.analysis.sweep_synthetic import embedded, origin, sweep_of
from tests.analysis.synthetic import like_fig6

EVIL = '</script><img src=x onerror="alert(1)">\u2028'
VALUES = pd.DataFrame({"parameter": ["B"], "value": ["1.5"], "unit": ["1/rad"]})


class Checker(HTMLParser):
    """Every tag that opens closes, in order; ids are unique; what refers to an id finds it."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(html)
        assert self.open == []
        ids = [at["id"] for _, at in self.tags if "id" in at]
        assert len(ids) == len(set(ids))
        for _, at in self.tags:
            for name in ("aria-labelledby", "for"):
                assert at.get(name) is None or at[name] in ids
            href = at.get("href") or ""
            assert not href.startswith("#") or href[1:] in ids

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def without_library(html: str) -> str:
    """What of a page is our own."""
    library = vega()
    assert library is not None
    assert html.count(library) == 1
    return html.replace(library, "")


def page_of_fig6(seeds: int = 3) -> str:
    about = [("Command", "a < b")]
    contents = Contents("Runs", about, ["a & b"], claims=pd.DataFrame({"claim": ["x"]}),
                references={"pacejka-tire_lf": 391.4})  # fmt: skip
    best = {"pacejka-tire_lf": Best("miho", 0, VALUES, ["note"], "reports/a b/report.html")}
    return sweep_page(sweep_of(*like_fig6(seeds)), contents, best)


def test_the_page_is_whole() -> None:
    html = page_of_fig6()
    checker = Checker(html)
    levels = [int(tag[1]) for tag, _ in checker.tags if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))
    scopes = [at.get("scope") for tag, at in checker.tags if tag == "th"]
    assert set(scopes) == {"col", "row"}
    for words in ("a &lt; b", "a &amp; b", "MIHO", 'href="reports/a%20b/report.html"', "24"):
        assert words in html
    assert embedded(html, "curves-0")["best"] == 0.3914


def test_only_its_own_script_runs_and_nothing_is_loaded() -> None:
    html = page_of_fig6()
    policy = re.search('Content-Security-Policy" content="([^"]*)"', html)
    assert policy
    assert "default-src 'none'" in policy[1]
    assert "unsafe" not in policy[1]
    for tag in ("script", "style"):
        (text,) = re.findall(f"<{tag}>(.*?)</{tag}>", html, flags=re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{tag}-src 'sha256-{digest}'" in policy[1]
        assert html.index("Content-Security-Policy") < html.index(f"<{tag}>")
    own_html = without_library(html)
    assert not re.search(r"(src|href)=\"(?!data:|#|reports/)", own_html)
    assert not re.search(r"\son\w+=|\sstyle=", own_html)
    assert "://" not in own_html


def test_what_comes_from_files_is_text() -> None:
    runs, curves = like_fig6(seeds=2)
    for column in ("problem", "optimizer", "outcome", "unit"):
        runs[column] = EVIL if column != "optimizer" else runs[column] + EVIL
    evil = origin({"model": {"_target_": f"a.{EVIL}", "x": EVIL}}, code=EVIL, data=EVIL,
                  python=EVIL, processor=EVIL, tag={EVIL: EVIL})  # fmt: skip
    sweep = sweep_of(runs, curves, **dict.fromkeys(runs["id"], evil))
    sweep = replace(sweep, damaged=pd.DataFrame({"folder": [EVIL], "reason": [EVIL]}))
    frame = pd.DataFrame({EVIL: [EVIL], "method": [EVIL]})
    contents = Contents(EVIL, [(EVIL, EVIL)], [EVIL], frame, EVIL, frame, EVIL)
    name = str(sweep.runs["problem"].iloc[0])
    best = {name: Best(EVIL, 0, frame, [EVIL], f"javascript:{EVIL}")}
    html = sweep_page(sweep, contents, best)
    checker = Checker(html)
    assert not [at for tag, at in checker.tags if tag == "img" or "onerror" in at]
    assert [tag for tag, _ in checker.tags].count("script") == 3
    assert "javascript:" not in [at.get("href", "")[:11] for _, at in checker.tags]
    about = embedded(html, "about")
    assert about["problems"] == [name]
    assert set(about["shown"]) == set(sweep.runs["optimizer"])  # type: ignore[call-overload]


def test_many_methods_open_with_the_best() -> None:
    runs, curves = arena(methods(14), problems=2, seeds=3)
    html = sweep_page(sweep_of(runs, curves), Contents("Arena"), {})
    Checker(html)
    assert "Initially the best 10 of 14 methods are shown" in html
    assert len(embedded(html, "about")["shown"]) == 10  # type: ignore[arg-type]
    assert 'id="curves-1"' in html
    assert 'aria-pressed="true">median</button>' in html
    few = page_of_fig6(seeds=1)
    assert "The line is the median" not in few
    assert "more than 1 run on a problem" in few


def test_seeds_are_thinned_and_the_page_says_so() -> None:
    html = page_of_fig6(seeds=40)
    assert "At most 30 of 40 seeds are drawn separately" in html
    axes: dict[str, dict[str, list[dict[str, list[str]]]]] = embedded(html, "curves-0")["axes"]  # type: ignore[assignment]
    assert len(axes["seconds"]["curves"][0]["seeds"]) == 30
    assert len(without_library(html)) < 500_000


def test_numbers_are_read_from_the_right() -> None:
    frame = pd.DataFrame({"m": ["a"], "x": [1.23456], "n": ["1,234"], "i": ["[1, 2]"], "w": ["b"]})
    html = environment().get_template("table.html").module.of(frame, "c")  # type: ignore[attr-defined]
    assert "<td>1.23</td><td>1,234</td><td>[1, 2]</td>" in html
    assert '<td class="text">b</td>' in html
    assert '<th scope="row" class="text">a</th>' in html


def test_no_text_in_the_chart_library_ends_the_script_and_a_page_stays_light() -> None:
    library = vega()
    assert library is not None
    assert "</script" not in library
    assert len(library.encode()) < 1_000_000


def test_the_chart_library_is_bundled_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    snippets = []

    def bundle(snippet: str) -> str:
        snippets.append(snippet)
        return "'</script>'"

    monkeypatch.setattr("vl_convert.javascript_bundle", bundle)
    assert vega(tmp_path / "cache") == vega(tmp_path / "cache") == "'<\\/script>'"
    assert len(snippets) == 1
    (path,) = (tmp_path / "cache").iterdir()
    for damaged in (path.read_bytes()[:-1], b"\xff", b""):
        path.write_bytes(damaged)
        assert vega(tmp_path / "cache") == "'<\\/script>'"
    assert len(snippets) == 4
    (tmp_path / "file").touch()
    assert vega(tmp_path / "file") == "'<\\/script>'"


def test_without_the_chart_library_the_page_has_figures_and_no_script(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "vl_convert", None)
    html = page_of_fig6()
    checker = Checker(html)
    tags = [tag for tag, _ in checker.tags]
    assert "script" not in tags
    assert "script-src" not in html
    assert "default-src 'none'; img-src data:" in html
    (picture,) = [at["src"] for tag, at in checker.tags if tag == "img"]
    assert str(picture).startswith("data:image/png;base64,iVBOR")
    assert "pip install vl-convert-python and create the report again" in html
    assert "://" not in html


@pytest.mark.parametrize(("unrecorded", "recorded"), [((), True), ({"pacejka-tire_lf"}, False)])
def test_the_best_of_the_runs_is_not_called_the_best_known(
    unrecorded: Collection[str], recorded: bool
) -> None:
    contents = Contents("Runs", references={"pacejka-tire_lf": 391.4}, unrecorded=unrecorded)
    html = sweep_page(sweep_of(*like_fig6(3)), contents, {})
    assert embedded(html, "curves-0")["recorded"] is recorded
    assert "gap to best known" not in html
