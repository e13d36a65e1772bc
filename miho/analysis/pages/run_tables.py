"""Tables of a report as text, with the digits that their errors allow, in convenient units."""

from __future__ import annotations

import math

import pandas as pd

from miho.analysis.text import ends, scaled, significant, to_error, with_error
from miho.identification import Report
from miho.identification.line_wrapping import with_unit
from miho.identification.parameters_file import interval_kind
from miho.study import StoredRun


def parameter_table(report: Report) -> pd.DataFrame:
    """The parameters as text, with the digits that their errors allow."""
    kinds = [interval_kind(report.parameters)]
    kinds += ["bootstrap"] * (report.replicates is not None and "bootstrap" not in kinds)
    kinds += _sandwich(report)
    rows = []
    for row in report.parameters.to_dict("records"):
        error = row["standard error"]
        cells = {
            "parameter": row["parameter"],
            "value": to_error(row["value"], error),
            "unit": row["unit"],
            "standard error": "at bound" if math.isnan(error) else to_error(error, error),
        }
        for kind in kinds:
            low, high = row[f"{kind} low"], row[f"{kind} high"]
            cells[_heading(report, kind)] = ends(low, high, error)
        rows.append(cells)
    return pd.DataFrame(rows)


def _sandwich(report: Report) -> list[str]:
    """The kind of intervals that account for uneven spread, if the spread is uneven."""
    return ["sandwich"] * (report.uneven and not report.conclusion.doubt)


def _heading(report: Report, kind: str) -> str:
    """The heading of the column of intervals of a kind."""
    local = " of this local optimum" * bool(report.conclusion.doubt)
    return f"{100 * report.level:g} % interval ({kind}){local}"


def values_table(stored: StoredRun) -> pd.DataFrame:
    """The stored parameters of a run, without errors or intervals."""
    pairs = zip(stored.result["parameters"], stored.result["theta"], strict=True)
    rows = [(about["name"], significant(value, 6), about["unit"]) for about, value in pairs]
    return pd.DataFrame(rows, columns=["parameter", "value", "unit"])


def derived_table(report: Report) -> pd.DataFrame:
    """The derived quantities as text, in convenient units."""
    rows = []
    kind = interval_kind(report.derived.drop(columns=["profile low"], errors="ignore"))
    heading = _heading(report, kind)
    if report.tied_profiles:
        heading = _heading(report, f"profile of tied parameters, else {kind}")
    for row in report.derived.to_dict("records"):
        if math.isnan(row["value"]):
            continue
        factor, unit = scaled(row["value"], row["unit"])
        value, error = row["value"] * factor, row["standard error"] * factor
        best = "profile" if not math.isnan(row.get("profile low", math.nan)) else kind
        cells = {
            "derived": row["quantity"],
            "value": with_error(value, error) if error > 0 else to_error(value, error),
            "unit": unit,
        }
        kinds = {heading: best} | {_heading(report, each): each for each in _sandwich(report)}
        for above, each in kinds.items():
            low, high = (row[f"{each} {end}"] * factor for end in ("low", "high"))
            cells[above] = ends(low, high, error)
        rows.append(cells)
    return pd.DataFrame(rows)


def error_table(report: Report) -> pd.DataFrame:
    """The errors as text; for the irreducible error, its range and a comparison with this fit."""
    rows = []
    for row in report.errors.to_dict("records"):
        error, remark = significant(row["error"]), ""
        if not math.isnan(row["low"]):
            error = f"{significant(row['low'], 4)} to {significant(row['high'], 4)}"
            remark = "estimated from neighbouring points"
            if not report.irreducible.resolved:
                remark += ", which are too far apart for a reliable estimate"
            elif report.error <= row["high"]:
                inside = "within the uncertainty of the estimate"
                remark += f"; this fit is {inside if report.error >= row['low'] else 'below it'}"
        rows.append(
            {
                "on": row["on"].removesuffix(", about"),
                "rows": row["rows"],
                "error": error,
                "unit": row["unit"],
                "remark": remark,
            }
        )
    table = pd.DataFrame(rows)
    return table if table["remark"].any() else table.drop(columns="remark")


def error_rows(report: Report) -> list[tuple[str, str]]:
    """The errors as rows for a terminal: name and text of each."""
    table = error_table(report).set_index("on")
    unit = report.problem.unit
    rows = [
        ("error", f"{with_unit(significant(report.error), unit)} (root mean square)"),
        (
            "deviation",
            f"{with_unit(significant(report.residual_standard_deviation), unit)} "
            f"(residual standard deviation, {report.freedom} degrees of freedom)",
        ),
    ]
    if "held out" in table.index:
        row = table.loc["held out"]
        rows.append(("held out", f"{with_unit(str(row['error']), unit)} ({row['rows']} rows)"))
    if "irreducible" in table.index:
        row = table.loc["irreducible"]
        rows.append(("irreducible", f"{with_unit(str(row['error']), unit)}, {row['remark']}"))
    return rows


def correlation_table(report: Report) -> pd.DataFrame:
    """The correlation matrix as text."""
    text = report.correlation.map(lambda r: "-" if math.isnan(r) else f"{r:+.2f}")
    return text.rename_axis("").reset_index()


def report_text(report: Report) -> str:
    """The report for a terminal: parameters, derived quantities and their interpretation."""
    parts = [parameter_table(report).to_string(index=False)]
    quantities = derived_table(report)
    if len(quantities):
        parts.append(quantities.to_string(index=False))
    if report.notes:
        parts.append("\n".join(f"- {sentence}" for sentence in report.notes))
    return "\n\n".join(parts)
