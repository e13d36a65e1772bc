"""Sentences of results in lines of the width of a terminal."""

from __future__ import annotations

import numpy as np

import miho
from miho.identification.printed import WIDTH, wrapped
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
