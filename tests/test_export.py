"""Tables for other tools, bit for bit."""

import csv
import hashlib
import json
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments import export
from miho import Budget, load_runs, minimize
from miho.analysis.export import write_csv
from miho.analysis.text import without_formula
from miho.optim import RandomSearch
from miho.study import Identity, Store, execute
from miho.testing import DecayFit

NASTY = [0.1 + 0.2, 5e-324, -1.7976931348623157e308, 1 / 3, np.pi * 1e-200, np.nan, -0.0, np.inf]


def root_of(folder: Path, seeds: int = 8) -> Path:
    root = folder / "runs"
    for seed in range(seeds):
        identity = Identity("decay", "random", seed, {}, "c0de", "da7a")
        record = minimize(RandomSearch(), DecayFit(), Budget(evaluations=40), seed)
        execute(Store(root), identity, lambda r=record: r, DecayFit.space, {"unit": "V"})
    return root


def nasty(root: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Real runs, whose numbers are made the ones that a careless writer changes."""
    stored = load_runs(root)
    runs, curves = stored.runs.copy(), stored.curves.copy()
    runs["theta.a"] = NASTY
    curves["error"] = np.resize(NASTY, len(curves))
    runs["optimizer"] = 'a "quoted", name\nof two lines'
    return runs, curves


def same_bits(one: Iterable[float], other: Iterable[float]) -> bool:
    """Equal, and -0.0 is not 0.0; any NaN equals any other."""
    numbers, others = (np.where(np.isnan(x), np.nan, x) for x in map(np.array, (one, other)))
    return numbers.astype(float).tobytes() == others.astype(float).tobytes()


def check_columns(folder: Path, file: str, table: pd.DataFrame) -> None:
    about = json.loads((folder / "columns.json").read_text())["files"][file]
    assert about["sha256"] == hashlib.sha256((folder / file).read_bytes()).hexdigest()
    assert (about["rows"], list(about["columns"])) == (len(table), list(table))
    assert all(column["meaning"] for column in about["columns"].values()), about["columns"]


def test_csv_numbers_come_back_bit_for_bit(tmp_path: Path) -> None:
    runs, curves = nasty(root_of(tmp_path))
    folder = tmp_path / "csv"
    write_csv(runs, curves, folder)
    assert sorted(path.name for path in folder.iterdir()) == [
        "columns.json", "curves.csv", "runs.csv"
    ]  # fmt: skip
    for file, table in (("runs.csv", runs), ("curves.csv", curves)):
        with (folder / file).open(newline="") as opened:
            back = list(csv.DictReader(opened))
        for column in table:
            read = [row[column] for row in back]
            if table[column].dtype.kind in "if":
                assert same_bits([float(text or "nan") for text in read], table[column]), column
            else:
                texts = ["" if pd.isna(value) else str(value) for value in table[column]]
                assert read == texts, column
        check_columns(folder, file, table)
    columns = json.loads((folder / "columns.json").read_text())["files"]["runs.csv"]["columns"]
    units = {p.name: p.unit for p in DecayFit.space.parameters}
    assert columns["theta.a"]["unit"] == {"decay": units["a"]}
    assert columns["seconds"]["unit"] == "s"


def command(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["export", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        export.main()
    return int(ended.value.code or 0)


def test_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    root = root_of(tmp_path, seeds=3)
    for _ in range(2):
        assert command(monkeypatch, root, "--to", "csv") == 0
        assert capsys.readouterr().out == f"3 runs in {root / 'exports' / 'csv'}\n"
    assert len(load_runs(root).runs) == 3
    assert load_runs(root).damaged.empty, "what is exported into a root is not taken for runs"

    assert command(monkeypatch, root, tmp_path / "one") == 0
    assert len(pd.read_csv(tmp_path / "one" / "runs.csv")) == 3

    result = next(root.rglob("result.json"))
    result.write_text(result.read_text()[:-9])
    assert command(monkeypatch, root, "--to", "csv", "--output", tmp_path / "two") == 0
    assert capsys.readouterr().err == "1 damaged runs were left out\n"
    assert len(pd.read_csv(tmp_path / "two" / "runs.csv")) == 2


def test_nothing_to_export(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(monkeypatch, tmp_path, "--to", "csv") == 2
    assert command(monkeypatch, tmp_path / "absent", "--to", "csv") == 2
    assert command(monkeypatch, tmp_path, tmp_path, "--output", tmp_path) == 2
    assert "no finished run" in capsys.readouterr().err


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


def test_text_cannot_become_a_formula(tmp_path: Path) -> None:
    """Names of received results; numbers, negative ones too, stay numbers, and "-" is a unit."""
    root = root_of(tmp_path, 4)
    stored = load_runs(root)
    runs = stored.runs.assign(theta=-1.5, unit="-")
    runs["problem"] = ["=1+1", "+cmd|' /C calc'!A0", "-2+3", "@SUM(1)"]
    runs["optimizer"] = "plain"
    write_csv(runs.rename(columns={"outcome": "=outcome"}), stored.curves, tmp_path / "csv")
    with (tmp_path / "csv" / "runs.csv").open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["problem"] for row in rows] == ["'=1+1", "'+cmd|' /C calc'!A0", "'-2+3", "'@SUM(1)"]
    assert {(row["theta"], row["unit"], row["optimizer"]) for row in rows} == {
        ("-1.5", "-", "plain")
    }
    assert "'=outcome" in rows[0]
    cells = [cell for row in rows for cell in (*row, *row.values())]
    assert not [cell for cell in cells if cell.startswith(("=", "+", "@"))]
