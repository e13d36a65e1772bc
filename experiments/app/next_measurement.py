"""Advice on the next measurement, from a stored run and a file of candidate rows."""

from __future__ import annotations

import csv
import io
from argparse import Namespace
from dataclasses import fields
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.app.build import ConfigError, stored_part
from experiments.app.explain import as_config_error
from miho.analysis.figures.design import design_figure
from miho.analysis.figures.house import png
from miho.analysis.text import csv_text, without_formula
from miho.data.csv import TextFormat, TextTable
from miho.data.measurements import Layout
from miho.identification import Report, optimal_design
from miho.study import StoredRun, write_bytes, write_text
from miho.units import UNITS

ROWS, TABLE, FIGURE = "next_rows.csv", "next.csv", "next.png"


def check_candidates(path: Path, rows: int) -> None:
    """Raise ConfigError if there is no such file, or if fewer than one row is requested."""
    if rows < 1:
        raise ConfigError(f"--rows is {rows}; expected at least 1")
    if not path.is_file():
        raise ConfigError(f"--next: there is no file {path}; give a CSV of candidates")


def advise(report: Report, stored: StoredRun, options: Namespace, folder: Path) -> str:
    """Choose rows and return the advice as text; write the rows, a table and a figure to `folder`.

    The `options` of `experiments.report` have the file of the candidates, the number of rows or
    groups to choose, and the goal.
    If the data of the run are from a file, the candidates have the same columns, headers, units and
    signs; else the columns are the inputs of the model in its units. Raises ConfigError and
    CSVError.
    """
    path, groups = options.candidates, options.groups
    table, frame = read_candidates(report, stored, path, groups)
    with as_config_error(f"--next {path}"):
        design = optimal_design(report, frame, options.rows, goal=options.goal, groups=groups)
    lines = [table.lines[0], *(table.lines[table.first + row] for row in design.chosen.index)]
    write_text(folder / ROWS, "".join(f"{_without_formulas(line, table)}\n" for line in lines))
    write_text(folder / TABLE, csv_text(design.table))
    write_bytes(folder / FIGURE, png(design_figure(design.rows, design.table)))
    return f"what to measure next: {design}\n\nrows {folder / ROWS}\nfigure {folder / FIGURE}\n"


def read_candidates(
    report: Report, stored: StoredRun, path: Path, groups: str | None
) -> tuple[TextTable, pd.DataFrame]:
    """Read the file; return it, and its rows: the inputs of the model, and the column of groups."""
    inputs = report.problem.model.inputs
    settings = stored_part(stored, "dataset")
    columns = list(inputs)
    units = [unit if unit in UNITS else f"own:{unit}" for unit in inputs.values()]
    headers, reading, text = list(columns), dict[str, Any](), TextFormat()
    joint = bool(stored_part(stored, "problem").get("parts"))  # the parts have different files
    if "columns" in settings and "units" in settings and not joint:
        named = list(settings["columns"])
        spelled = dict(zip(named, settings["units"], strict=True))
        called = dict(zip(named, settings.get("headers") or named, strict=True))
        units, headers = [spelled[name] for name in columns], [called[name] for name in columns]
        reading = {
            "convention": settings.get("convention", "iso-w"),
            "flip": [name for name in settings.get("flip") or () if name in columns],
            "ranges": {k: v for k, v in (settings.get("ranges") or {}).items() if k in columns},
        }
        written = {field.name for field in fields(TextFormat)} - {"drop_rows", "missing"}
        text = TextFormat(**{name: settings[name] for name in written & set(settings)})
    layout = Layout(columns, units, columns[0], headers, **reading)
    extra = [groups] if groups is not None and groups not in headers else []
    table = TextTable(path, [*headers, *extra], header=True, text=text)
    numbers = table.numbers()
    frame = pd.DataFrame(layout.si_columns(numbers, table.fault)[0])
    return table, frame if groups is None else frame.assign(**{groups: numbers[groups]})


def _without_formulas(line: str, table: TextTable) -> str:
    """The line with an apostrophe before each cell that a spreadsheet would evaluate."""
    cells = next(csv.reader([line], delimiter=table.delimiter))
    plain = [cell if _is_number(cell, table.decimal) else without_formula(cell) for cell in cells]
    if plain == cells:
        return line
    text = io.StringIO()
    csv.writer(text, delimiter=table.delimiter, lineterminator="").writerow(plain)
    return text.getvalue()


def _is_number(cell: str, decimal: str) -> bool:
    try:
        float(cell.replace(decimal, "."))
    except ValueError:
        return False
    return True
