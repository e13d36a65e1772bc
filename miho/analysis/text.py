"""Format numbers, intervals and tables for terminals, Markdown and pages."""

from __future__ import annotations

import math
import re
from types import MappingProxyType
from typing import Any

import pandas as pd

from miho.analysis.compare.bootstrap import Interval

SMALL, LARGE = 1e-4, 1e9
"""Numbers below SMALL and from LARGE on are printed with a power of ten."""
KILO = 1e4
"""Values from this on are written in thousands of their unit."""
DIGITS = 10
"""Significant digits of a value at most: further ones are rounding."""
PLACES = 6
"""Numbers that need more decimals than this are written with a power of ten."""
USUAL = MappingProxyType({"rad": (180 / math.pi, "deg"), "rad/s": (30 / math.pi, "rpm")})
PREFIXED = ("N", "Pa")
_NUMBER = r"[-+−]?[\d.,]*\d(e[-+]?\d+)?"
NUMERIC = re.compile(rf"{_NUMBER}( ± {_NUMBER})?|[-∞]|[-+]?inf|never|\[.*\]")
"""Pattern of a cell in a column of numbers."""


def number(value: float) -> str:
    """Three significant digits, whole numbers with thousands separators, "never" for inf.

    Numbers below 0.0001 have a power of ten, for example 3.00e-11.

    Examples
    --------
    >>> from miho.analysis.text import number
    >>> number(1234.5), number(0.012345), number(float("inf"))
    ('1,234', '0.0123', 'never')
    """
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "never" if value > 0 else "-∞"
    if abs(value) >= 1000 or float(value).is_integer():
        return f"{value:,.0f}"
    if abs(value) < SMALL:
        return f"{value:.2e}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"


def significant(value: float, digits: int = 5) -> str:
    """A number of significant digits, all digits before the point, "∞" for inf, "-" for NaN."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    if 10 ** (digits - 1) <= abs(value) < LARGE:
        return f"{value:,.0f}"
    return f"{value:.{digits}g}"


def rounded(value: float, digits: int) -> float:
    """The value rounded to `digits` significant digits."""
    return float(f"{float(value):.{digits}g}")


def scaled(value: float, unit: str) -> tuple[float, str]:
    """The factor to multiply by and the resulting unit.

    rad becomes deg, rad/s becomes rpm, and N/rad becomes kN/rad for large values.
    """
    if unit in USUAL:
        return USUAL[unit]
    if unit.startswith(PREFIXED) and math.isfinite(value) and abs(value) >= KILO:
        return 1e-3, f"k{unit}"
    return 1.0, unit


def to_error(value: float, error: float) -> str:
    """A value with as many digits as its error allows (two of the error); "-" for NaN.

    Six significant digits if the error is 0 or not finite, and ten at most.

    Examples
    --------
    >>> from miho.analysis.text import to_error, with_error
    >>> to_error(3.14159, 0.012), with_error(3.14159, 0.012)
    ('3.142', '3.142 ± 0.012')
    """
    if math.isnan(value):
        return "-"
    if not math.isfinite(error) or error <= 0 or math.isinf(value):
        return f"{value:.6g}"
    if error < abs(value) / 10**DIGITS:
        return f"{value:.{DIGITS}g}"
    places = max(0, 1 - math.floor(math.log10(error)))
    if places > PLACES:
        exponent = math.floor(math.log10(max(abs(value), error)))
        return f"{value:.{max(0, places + exponent)}e}"
    return f"{value:.{places}f}"


def with_error(value: float, error: float) -> str:
    """Format "value ± error", both with the digits that the error allows."""
    return f"{to_error(value, error)} ± {to_error(error, error)}"


def ends(low: float, high: float, error: float) -> str:
    """Format "[low, high]" with the digits of the error; "-" if both ends are unknown.

    An infinite end with a finite error is "open": a profile reached the bound of the space first.
    """
    if math.isnan(low) and math.isnan(high):
        return "-"
    texts = [
        "open" if math.isinf(end) and math.isfinite(error) else to_error(end, error)
        for end in (low, high)
    ]
    return f"[{', '.join(texts)}]"


def with_interval(interval: Interval, unit: str) -> str:
    """An estimate with its 95 % interval, for example "0.392 kN [0.391, 0.394]".

    A value that is only known within bounds reads "more than 5.2×" or "5.2 to 8.1×".
    """
    low, estimate, at_most, high = (
        "∞" if value == math.inf else number(value)
        for value in (interval.low, interval.estimate, interval.at_most, interval.high)
    )
    if interval.at_most > interval.estimate:
        bounded = math.isfinite(interval.at_most)
        estimate = f"{estimate} to {at_most}" if bounded else f"more than {estimate}"
    return f"{estimate}{unit} [{low}, {high}]"


def cell(value: object) -> str:
    """The text of a value in a table: strings unchanged, numbers by `number`."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return number(float(value))
    return str(value)


def is_numeric(column: pd.Series) -> bool:
    """Return whether a column shows only numbers, which are aligned to the right."""
    return all(NUMERIC.fullmatch(cell(value)) for value in column)


def to_markdown(frame: pd.DataFrame) -> str:
    """A pipe table without the index, numbers aligned to the right; ends with a newline.

    Numbers have three significant digits; inf reads "never", NaN reads "-".

    Parameters
    ----------
    frame : DataFrame
        The table.

    Returns
    -------
    str
        The table in Markdown.

    Examples
    --------
    >>> import pandas as pd
    >>> from miho.analysis import to_markdown
    >>> print(to_markdown(pd.DataFrame({"method": ["miho"], "seconds": [0.12345]})), end="")
    | method | seconds |
    | --- | --: |
    | miho | 0.123 |
    """
    names = [_escaped(name) for name in frame.columns]
    rule = ["--:" if pd.api.types.is_numeric_dtype(kind) else "---" for kind in frame.dtypes]
    rows = [[_escaped(cell(value)) for value in row] for row in frame.itertuples(index=False)]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in [names, rule, *rows])


FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""First characters of a formula in a spreadsheet (OWASP, "CSV Injection")."""
MEASURED = re.compile(rf"{_NUMBER}(\s([\w\s.,%°±×∞\[\]]|(?<=\[)[-+]|(?<=, )[-+])*)?")
"""A number, optionally with a unit and an interval; an inner sign is allowed only at an end's
beginning."""


def csv_text(table: pd.DataFrame, **keywords: Any) -> str:
    """A table as CSV without its index; `keywords` are passed to `pandas.DataFrame.to_csv`.

    Names and text that a spreadsheet would run as a formula get a leading apostrophe, because they
    can come from others.
    """
    plain = table.rename(columns=without_formula)
    for place, kind in enumerate(table.dtypes):
        if not pd.api.types.is_numeric_dtype(kind):
            name = plain.columns[place]
            plain[name] = table.iloc[:, place].map(without_formula)
    return str(plain.to_csv(index=False, lineterminator="\n", **keywords))


def without_formula(cell: object) -> object:
    """Prefix text that begins like a formula with an apostrophe.

    Numbers, also with a unit and an interval, are unchanged, and so is a single "-", which is a
    unit.
    """
    if not isinstance(cell, str) or cell == "-" or MEASURED.fullmatch(cell):
        return cell
    return f"'{cell}" if cell.startswith(FORMULA) else cell


def _escaped(text: object) -> str:
    return str(text).replace("|", r"\|").replace("\n", " ")
