"""Sentences of results in lines of the width of a terminal."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import miho
from miho.identification.line_wrapping import WIDTH, for_terminal, with_unit, wrapped
from tests.printed import flat


def test_a_long_line_is_broken_at_spaces_and_an_item_is_indented() -> None:
    words = " ".join(["steady-state"] * 40)
    for line, indent in ((words, ""), (f"- {words}", "  ")):
        lines = wrapped(line).split("\n")
        assert max(map(len, lines)) <= WIDTH
        assert all(later.startswith(f"{indent}steady-state") for later in lines[1:])
        assert flat("\n".join(lines)) == line
    assert wrapped("short") == "short"
    assert wrapped("") == ""
    assert wrapped("x" * 300) == "x" * 300


def test_a_printed_fit_and_report_fit_a_terminal_and_show_tied_quantities() -> None:
    t = np.linspace(0, 2, 50)
    y = 2 * np.exp(-1.5 * t) + 0.05 * np.random.default_rng(1).standard_normal(50)

    def decay(t, a, b):
        return a * np.exp(-b * t)

    bounds = {"a": (0, 1.9), "b": (0, 10), "K": {"unit": "V/s"}}
    fit = miho.fit(decay, t, y, bounds, tied={"K": "a * b"})
    report = fit.report()
    for text in (str(fit), str(report)):
        assert max(map(len, text.split("\n"))) <= WIDTH
    assert "K = a * b" in str(report)
    assert "(root mean square of 50 rows); intervals of 95 %" in str(report)


def test_text_for_a_terminal_is_broken_to_its_width(monkeypatch: pytest.MonkeyPatch) -> None:
    optimum = "optimum      " + "found by seven searches " * 5
    table = "derived   value  unit  95 % interval   sandwich interval"
    text = "\n".join([table, "- an item " + "of words " * 5, optimum.rstrip()])
    assert for_terminal(text) == text, "no terminal"
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "50")
    lines = for_terminal(text).split("\n")
    assert lines[0] == table
    assert lines[2] == "  words"
    assert lines[-1] == " " * 13 + "found by seven searches"
    assert max(map(len, lines[1:])) <= 50
    assert flat("\n".join(lines)) == flat(text)


def test_a_dimensionless_number_has_no_unit() -> None:
    assert [with_unit("1.2", unit) for unit in ("N", "-", "")] == ["1.2 N", "1.2", "1.2"]
