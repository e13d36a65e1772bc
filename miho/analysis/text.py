"""Numbers, intervals and tables as a reader wants them, for terminals, Markdown and pages."""

from __future__ import annotations

import math
import re
from types import MappingProxyType
from typing import Any

import pandas as pd

from miho.analysis.compare.bootstrap import Interval

SMALL, LARGE = 1e-4, 1e9
"""Numbers below the one and from the other on are printed with a power of ten."""
KILO = 1e4
"""Values from here on are written in thousands of their unit."""
PLACES = 6
"""Numbers that need more decimals than this are written with a power of ten."""
USUAL = MappingProxyType({"rad": (180 / math.pi, "deg"), "rad/s": (30 / math.pi, "rpm")})
PREFIXED = ("N", "Pa")
_NUMBER = r"[-+−]?[\d.,]*\d(e[-+]?\d+)?"
NUMERIC = re.compile(rf"{_NUMBER}( ± {_NUMBER})?|[-∞]|[-+]?inf|never|\[.*\]")
"""What a cell of a column of numbers reads like."""


def number(value: float) -> str:
    """Three significant digits, whole numbers with thousands separated, "never" for inf.

    Below 0.0001 with a power of ten, such as 3.00e-11.
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
    """So many significant digits, all digits before the point, "∞" for inf, "-" for NaN."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    if 10 ** (digits - 1) <= abs(value) < LARGE:
        return f"{value:,.0f}"
    return f"{value:.{digits}g}"


def rounded(value: float, digits: int) -> float:
    """The number that is left of a value with so many significant digits."""
    return float(f"{float(value):.{digits}g}")


def scaled(value: float, unit: str) -> tuple[float, str]:
    """The factor to multiply by and the unit it gives.

    rad becomes deg, rad/s becomes rpm, and N/rad becomes kN/rad for large values.
    """
    if unit in USUAL:
        return USUAL[unit]
    if unit.startswith(PREFIXED) and math.isfinite(value) and abs(value) >= KILO:
        return 1e-3, f"k{unit}"
    return 1.0, unit


def to_error(value: float, error: float) -> str:
    """A value with the digits that its error leaves, two of the error; "-" for NaN.

    Six significant digits where the error is 0 or not finite.
    """
    if math.isnan(value):
        return "-"
    if not math.isfinite(error) or error <= 0 or math.isinf(value):
        return f"{value:.6g}"
    places = max(0, 1 - math.floor(math.log10(error)))
    if places > PLACES:
        exponent = math.floor(math.log10(max(abs(value), error)))
        return f"{value:.{max(0, places + exponent)}e}"
    return f"{value:.{places}f}"


def with_error(value: float, error: float) -> str:
    """ "value ± error", both with the digits the error leaves."""
    return f"{to_error(value, error)} ± {to_error(error, error)}"


def ends(low: float, high: float, error: float) -> str:
    """ "[low, high]" with the digits of the error; "-" if both ends are unknown.

    An infinite end beside a finite error is open: a profile came to the edge of the box first.
    """
    if math.isnan(low) and math.isnan(high):
        return "-"
    texts = [
        "open" if math.isinf(end) and math.isfinite(error) else to_error(end, error)
        for end in (low, high)
    ]
    return f"[{', '.join(texts)}]"


def with_interval(interval: Interval, unit: str) -> str:
    """An estimate with its 95 % interval, such as "0.392 kN [0.391, 0.394]".

    What is known within bounds only reads "more than 5.2×" or "5.2 to 8.1×".
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
    """What a table shows of a value: words as they are, numbers as `number` has them."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return number(float(value))
    return str(value)


def is_numeric(column: pd.Series) -> bool:
    """Whether a column shows numbers, which are read from the right, and no words or units."""
    return all(NUMERIC.fullmatch(cell(value)) for value in column)


def to_markdown(frame: pd.DataFrame) -> str:
    """A pipe table without the index, numbers aligned to the right; ends with a newline.

    Numbers have three significant digits; inf reads "never", NaN reads "-".
    """
    names = [_escaped(name) for name in frame.columns]
    rule = ["--:" if pd.api.types.is_numeric_dtype(kind) else "---" for kind in frame.dtypes]
    rows = [[_escaped(cell(value)) for value in row] for row in frame.itertuples(index=False)]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in [names, rule, *rows])


FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""What a formula begins with in a spreadsheet (OWASP, "CSV Injection")."""
MEASURED = re.compile(rf"{_NUMBER}(\s([\w\s.,%°±×∞\[\]]|(?<=\[)[-+]|(?<=, )[-+])*)?")
"""A number, with a unit and an interval if any; a sign inside stands only where an end begins."""


def csv_text(table: pd.DataFrame, **keywords: Any) -> str:
    """A table as CSV without its index; `keywords` are those of `pandas.DataFrame.to_csv`.

    Names and text that a spreadsheet would run as a formula get an apostrophe before them, since
    they can come from others.
    """
    plain = table.rename(columns=without_formula)
    for place, kind in enumerate(table.dtypes):
        if not pd.api.types.is_numeric_dtype(kind):
            name = plain.columns[place]
            plain[name] = table.iloc[:, place].map(without_formula)
    return str(plain.to_csv(index=False, lineterminator="\n", **keywords))


def without_formula(cell: object) -> object:
    """Text that begins as a formula does, behind an apostrophe.

    Numbers, also with a unit and an interval, stay as they are, and so does a lone "-", a unit.
    """
    if not isinstance(cell, str) or cell == "-" or MEASURED.fullmatch(cell):
        return cell
    return f"'{cell}" if cell.startswith(FORMULA) else cell


def _escaped(text: object) -> str:
    return str(text).replace("|", r"\|").replace("\n", " ")
