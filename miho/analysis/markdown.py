"""Tables as Markdown, and numbers as tables print them."""

from __future__ import annotations

import math

import pandas as pd

from miho.analysis.statistics import Interval

SMALL = 1e-4
"""Numbers that are printed with a power of ten."""


def to_markdown(frame: pd.DataFrame) -> str:
    """A pipe table without the index, numbers aligned to the right; ends with a newline.

    Numbers have three significant digits; inf reads "never", NaN reads "-".
    """
    names = [_escape(str(name)) for name in frame.columns]
    rule = ["--:" if pd.api.types.is_numeric_dtype(kind) else "---" for kind in frame.dtypes]
    rows = [[_cell(value) for value in row] for row in frame.itertuples(index=False)]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in [names, rule, *rows])


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


def with_interval(ours: Interval, unit: str) -> str:
    """An estimate with its 95 % interval, such as "0.392 kN [0.391, 0.394]".

    What is known within bounds only reads "more than 5.2×" or "5.2 to 8.1×".
    """
    low, estimate, at_most, high = (
        "∞" if value == math.inf else number(value)
        for value in (ours.low, ours.estimate, ours.at_most, ours.high)
    )
    if ours.at_most > ours.estimate:
        bounded = math.isfinite(ours.at_most)
        estimate = f"{estimate} to {at_most}" if bounded else f"more than {estimate}"
    return f"{estimate}{unit} [{low}, {high}]"


def _cell(value: object) -> str:
    if isinstance(value, bool | str):
        return _escape(str(value))
    if isinstance(value, int | float):
        return number(value)
    return _escape(str(value))


def _escape(text: str) -> str:
    return text.replace("|", r"\|").replace("\n", " ")
