"""Printed results, compared without their line breaks and last digits."""

from __future__ import annotations

import re

import pytest

DIGITS = 1e-3
"""Numbers are printed to five digits; solvers of SciPy and other processors move the last ones."""
EVIDENCE = re.compile(r"Converged: .*?Estimated chance[^\n]*", re.DOTALL)
"""The statement on the search, whose counts may differ where a function runs in NumPy."""
OMITTED = "..."
"""A line that stands for any further lines."""


def flat(result: object) -> str:
    """What a result prints, in one line with single spaces."""
    return " ".join(str(result).split())


def words(text: str) -> list[str]:
    """The words, brackets and numbers of a printed result, without the search's counts."""
    return re.sub(r"[\[\]()=,](?!\d)", r" \g<0> ", EVIDENCE.sub("", text)).split()


def number(word: str) -> float | None:
    """The number in a word such as `±19`, `0.41` or `1,981`, or None."""
    plain = word.strip("±(),;%").replace(",", "")
    try:
        return float(plain)
    except ValueError:
        return None


def check_printed(printed: str, stored: str) -> None:
    """Compare a printed result with the stored one, which may omit further lines at its end."""
    shown = stored.removesuffix(f"\n{OMITTED}")
    expected, found = words(shown), words(printed)
    if shown == stored:
        assert len(found) == len(expected)
    for now, before in zip(found, expected, strict=False):
        value, number_before = number(now), number(before)
        if value is None or number_before is None:
            assert now == before
        else:
            assert value == pytest.approx(number_before, rel=DIGITS, abs=1e-9, nan_ok=True)
