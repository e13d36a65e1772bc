"""Text of tables that a spreadsheet does not run as a formula."""

import csv
import io

import pandas as pd
import pytest

from miho.analysis.text import csv_text, without_formula


@pytest.mark.parametrize(
    "cell", ["-0.5", "+1e-3", "-1,234", "-0.0266 % [-0.0476, -0.0121]", "-3.1 ± 0.2 kN", "-", "a=b"]
)
def test_numbers_in_text_stay(cell: str) -> None:
    assert without_formula(cell) == cell


@pytest.mark.parametrize(
    "cell",
    ["=1", "@SUM(1)", "+cmd", "-2+3", "-2 +3", "-2 -3", "-1 cmd|' /C calc'!A0", "-1 SUM(A1)", "-A1",
     "-1, +cmd|' /C calc'!A0", "-1 [-A1*2]"],
)  # fmt: skip
def test_formulas_in_text_do_not_stay(cell: str) -> None:
    assert without_formula(cell) == f"'{cell}"


def test_text_cannot_become_a_formula() -> None:
    """Names of received results; numbers, negative ones too, stay numbers, and "-" is a unit."""
    names = ["=1+1", "+cmd|' /C calc'!A0", "-2+3", "@SUM(1)"]
    table = pd.DataFrame({"problem": names, "theta": -1.5, "unit": "-", "=outcome": "plain"})
    rows = list(csv.DictReader(io.StringIO(csv_text(table))))
    assert [row["problem"] for row in rows] == [f"'{name}" for name in names]
    assert {(row["theta"], row["unit"], row["'=outcome"]) for row in rows} == {
        ("-1.5", "-", "plain")
    }
