"""Sentences of results in lines of the width of a terminal."""

from __future__ import annotations

import textwrap

WIDTH = 100
"""Columns of a printed line."""


def wrapped(line: str, width: int = WIDTH, indent: int | None = None) -> str:
    """A line broken at spaces to `width` columns; further lines are indented.

    The indent is 2 for an item of a list, which begins with "- ", and 0 otherwise, unless given.
    """
    indent = 2 * line.startswith("- ") if indent is None else indent
    return textwrap.fill(
        line,
        max(width, indent + 20),
        subsequent_indent=" " * indent,
        break_long_words=False,
        break_on_hyphens=False,
        replace_whitespace=False,
        drop_whitespace=True,
    )
