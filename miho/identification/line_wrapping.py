"""Sentences of results in lines of the width of a terminal."""

from __future__ import annotations

import math
import re
import shutil
import sys
import textwrap
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

WIDTH = 100
"""Columns of a printed line."""
LOST = 1e5
"""A value that is this multiple of its standard error needs more than five digits."""
TIED = "\N{NO-BREAK SPACE}"
"""A space at which no line is broken."""
LABEL = 13
"""Columns of the label of a line, such as "optimum"."""
LABELLED = re.compile(rf"(?=.{{{LABEL}}}\S)[a-z][a-z ]* \S")


def wrapped(line: str, width: int = WIDTH, indent: int | None = None) -> str:
    """A line broken at spaces to `width` columns; further lines are indented.

    The indent is 2 for an item of a list, which begins with "- ", and 0 otherwise, unless given.
    """
    indent = 2 * line.startswith("- ") if indent is None else indent
    return textwrap.fill(
        line.replace(" %", f"{TIED}%"),
        max(width, indent + 20),
        subsequent_indent=" " * indent,
        break_long_words=False,
        break_on_hyphens=False,
        replace_whitespace=False,
    ).replace(TIED, " ")


def with_unit(number: str, unit: str) -> str:
    """A number as text with its unit, which a dimensionless one, "-", does not have."""
    return f"{number} {unit}" if unit.strip("-") else number


def with_digits(table: pd.DataFrame, error: str) -> pd.DataFrame:
    """A table with texts for values and ends of which five digits would not show the `error`."""
    lost = (table["value"].abs() > LOST * table[error]) & (table[error] > 0)
    if lost.any():
        table = table.astype(object)
    for row in table.index[lost]:
        value: Any = table.at[row, "value"]
        spread: Any = table.at[row, error]
        digits = min(17, 3 + int(math.log10(abs(value)) - math.log10(spread)))
        for column in table.columns[table.columns.str.contains("value|low|high")]:
            number: Any = table.at[row, column]
            if math.isfinite(number):
                table.at[row, column] = f"{number:.{digits}g}"
    return table


def for_terminal(text: str) -> str:
    """The text with its sentences broken to the width of the terminal; tables stay as they are.

    Text for a file or a pipe is returned unchanged.
    """
    if not sys.stdout.isatty():
        return text
    width = shutil.get_terminal_size().columns
    return "\n".join(_fitted(line, width) for line in text.split("\n"))


def _fitted(line: str, width: int) -> str:
    indent = LABEL if LABELLED.match(line) else None
    words = line[LABEL if indent else 0 :].strip()
    whole = "  " in words or " " not in words  # a row of a table, or a path
    return line if len(line) <= width or whole else wrapped(line, width, indent)
