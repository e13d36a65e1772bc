"""Write the runs of a root in a format that other tools read.

python -m experiments.export runs/arena --to csv                      # runs/arena/exports/csv
python -m experiments.export runs/arena --to parquet --output FOLDER
python -m experiments.export runs/arena ioh-folder   # IOHprofiler: IOHanalyzer, iohinspector

CSV and Parquet hold two tables, a row per run and a row per step of its curve, and columns.json
beside them says what each column is, in which unit, and the checksums of both files.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.app.build import ConfigError, MissingLibraryError
from experiments.app.console import guarded
from miho.analysis import write_ioh
from miho.study import load_runs, read_run, write_text
from miho.study.identity import sha256

COLUMNS = "columns.json"
FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""What a formula begins with in a spreadsheet (OWASP, "CSV Injection")."""
MEANING = {
    "id": ("", "hash of configuration, code, data and seed"),
    "problem": ("", "model and data"),
    "optimizer": ("", "method"),
    "seed": ("", "repetition; one seed gives all methods the same start"),
    "outcome": ("", "how the run ended: budget, converged, brackets or no_finite_value"),
    "error": ("see column unit of the runs", "root of the loss, best so far"),
    "unit": ("", "of the error"),
    "evaluations": ("evaluations of the loss", "used so far; parts of the data count as parts"),
    "seconds": ("s", "wall clock of the method alone"),
    "cpu_seconds": ("s", "processor time of the method alone"),
    "setup_seconds": ("s", "imports, compilation and warm-up, not in seconds"),
    "irreducible": ("see column unit", "estimate of the error no model of the same inputs beats"),
    "irreducible_low": ("see column unit", "lower end of that estimate's 95 % interval"),
    "irreducible_high": ("see column unit", "upper end of it"),
    "optimum": ("see column unit", "smallest error in the space, where it is known"),
    "dimension": ("", "number of parameters"),
    "timing_valid": ("", "whether the machine was quiet enough for the seconds to be compared"),
    "folder": ("", "where the run lies"),
}
"""Unit and meaning of the columns of `miho.load_runs`."""


def write_csv(runs: pd.DataFrame, curves: pd.DataFrame, folder: Path) -> None:
    """Write runs.csv and curves.csv: UTF-8, numbers as the shortest text that gives them back.

    Python's `float` returns them bit for bit, and so does `pandas.read_csv` from pandas 3.1 on; an
    older one needs `float_precision="round_trip"`. An empty field is a number that is not known.
    Text that a spreadsheet would run as a formula gets an apostrophe before it, since results can
    come from others.
    """

    def written(table: pd.DataFrame, path: Path) -> str:
        text = _without_formulas(table).to_csv(index=False, lineterminator="\n")
        write_text(path, text)
        return sha256(text)

    reader = 'pandas.read_csv(path), before pandas 3.1 with float_precision="round_trip"'
    _write({"runs.csv": runs, "curves.csv": curves}, folder, reader, written)


def _without_formulas(table: pd.DataFrame) -> pd.DataFrame:
    """Names and text that begin as a formula does, behind an apostrophe; a lone "-" is a unit."""

    def quoted(cell: object) -> object:
        formula = isinstance(cell, str) and cell != "-" and cell.startswith(FORMULA)
        return f"'{cell}" if formula else cell

    plain = table.rename(columns=quoted)
    for place, kind in enumerate(table.dtypes):
        if not pd.api.types.is_numeric_dtype(kind):
            name = plain.columns[place]
            plain[name] = table.iloc[:, place].map(quoted)
    return plain


def write_parquet(runs: pd.DataFrame, curves: pd.DataFrame, folder: Path) -> None:
    """Write runs.parquet and curves.parquet, with a checksum on every page.

    `pyarrow.parquet.read_table(path, page_checksum_verification=True)` raises on a damaged page;
    readers that do not verify them return wrong numbers. Raises MissingLibraryError.
    """
    if importlib.util.find_spec("pyarrow") is None:
        raise MissingLibraryError("parquet: pyarrow is not installed; pip install 'miho[parquet]'")

    def written(table: pd.DataFrame, path: Path) -> str:
        temporary = path.with_name(f".{path.name}.{os.getpid()}")
        try:
            table.to_parquet(temporary, engine="pyarrow", index=False, write_page_checksum=True)
            digest = sha256(temporary.read_bytes())
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
        return digest

    reader = "pyarrow.parquet.read_table(path, page_checksum_verification=True)"
    _write({"runs.parquet": runs, "curves.parquet": curves}, folder, reader, written)


def _write(
    tables: Mapping[str, pd.DataFrame],
    folder: Path,
    reader: str,
    written: Callable[[pd.DataFrame, Path], str],
) -> None:
    """Write the tables, that of the runs first, and last of all what they hold."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / COLUMNS).unlink(missing_ok=True)
    files: dict[str, Any] = {}
    units = _units(next(iter(tables.values())))
    for name, table in tables.items():
        columns = {str(key): _column(str(key), kind, units) for key, kind in table.dtypes.items()}
        digest = written(table, folder / name)
        files[name] = {"sha256": digest, "rows": len(table), "columns": columns}
    write_text(folder / COLUMNS, json.dumps({"read with": reader, "files": files}, indent=1) + "\n")


def _column(name: str, kind: object, units: dict[str, dict[str, str]]) -> dict[str, Any]:
    if name.startswith("theta."):
        meaning = "value of the parameter in the best point, empty where a problem has none"
        return {"type": str(kind), "unit": units.get(name, {}), "meaning": meaning}
    unit, meaning = MEANING.get(name, ("", ""))
    return {"type": str(kind), "unit": unit, "meaning": meaning}


def _units(runs: pd.DataFrame) -> dict[str, dict[str, str]]:
    """The unit of each parameter by problem, from one run of each."""
    units: dict[str, dict[str, str]] = {}
    for problem, folder in runs.drop_duplicates("problem")[["problem", "folder"]].to_numpy():
        for parameter in read_run(Path(folder)).result["parameters"]:
            units.setdefault(f"theta.{parameter['name']}", {})[problem] = parameter["unit"]
    return units


WRITERS = {"ioh": write_ioh, "csv": write_csv, "parquet": write_parquet}


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.export",
        description="Export finished runs: as tables in CSV or Parquet, or in the IOHprofiler "
        "format (errors over evaluations, a folder for each method), which IOHanalyzer and "
        "iohinspector read.",
    )
    parser.add_argument("root", type=Path, help="folder of runs")
    parser.add_argument("folder", type=Path, nargs="?", help="the same as --output")
    parser.add_argument("--to", choices=sorted(WRITERS), default="ioh", help="format (ioh)")
    parser.add_argument(
        "--output", type=Path, help="folder, new or empty for ioh; by default ROOT/exports/FORMAT"
    )
    arguments = parser.parse_args()
    if arguments.folder is not None and arguments.output is not None:
        parser.error("give the folder once: as the second argument or with --output")
    output = arguments.output or arguments.folder
    if output is None:
        output = arguments.root / "exports" / arguments.to

    def job() -> None:
        found = load_runs(arguments.root)
        if found.runs.empty:
            raise ConfigError(f"{arguments.root}: holds no finished runs; run something first")
        try:
            WRITERS[arguments.to](found.runs, found.curves, output)
        except (ValueError, FileExistsError) as error:
            raise ConfigError(str(error)) from None
        if len(found.damaged):
            print(f"{len(found.damaged)} damaged runs were left out", file=sys.stderr)
        print(f"{len(found.runs)} runs in {output}")

    guarded(job)


if __name__ == "__main__":
    main()
