"""Tables of a root: every number as in the files, nothing damaged, nothing from elsewhere."""

import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from miho import load_runs
from miho.optim import Budget, RandomSearch, minimize
from miho.study import DamagedRun, Identity, Store, read_run
from miho.study.identity import canonical, sha256
from miho.testing import DecayFit
from tests.faults.stored_runs import POINTS, make_runs


@pytest.fixture
def folders(tmp_path: Path) -> list[Path]:
    return make_runs(tmp_path / "root", 12, np.random.default_rng(0))


def forge(folder: Path, curve: Any = None, **changes: Any) -> None:
    """Change a run and give it the checksums that belong to the changed files."""
    result = json.loads((folder / "result.json").read_text())
    del result["sha256"]
    result |= changes
    if curve is not None:
        (folder / "curve.json").write_text(json.dumps(curve))
        result["files"]["curve.json"] = sha256(json.dumps(curve))
    result["sha256"] = sha256(canonical(result))
    (folder / "result.json").write_text(canonical(result))


def test_every_number_is_that_of_the_files(tmp_path: Path) -> None:
    folders = make_runs(tmp_path, 300, np.random.default_rng(0))
    runs = load_runs(tmp_path)
    assert repr(runs).startswith(f"<Runs in {tmp_path}: ")
    assert len(repr(runs)) < 200 + len(str(tmp_path)), "the texts of curves are not printed"
    assert runs.damaged.empty
    assert (len(runs.runs), len(runs.curves)) == (300, 300 * POINTS)
    assert sorted(runs.runs["folder"]) == sorted(map(str, folders))
    order = runs.runs[["problem", "optimizer", "seed"]]
    pd.testing.assert_frame_equal(order, order.sort_values(list(order)))
    assert runs.curves["id"].unique().tolist() == runs.runs["id"].tolist()
    curves = dict(list(runs.curves.groupby("id")))
    for row in runs.runs.to_dict("records"):
        folder = Path(row["folder"])
        result = json.loads((folder / "result.json").read_text())
        for key in ("id", "problem", "optimizer", "seed", "evaluations", "seconds", "outcome"):
            assert row[key] == result[key]
        assert row["error"] == math.sqrt(result["loss"])
        assert row["optimum"] == math.sqrt(result["facts"]["optimum"])
        names = [parameter["name"] for parameter in result["parameters"]]
        assert [row[f"theta.{name}"] for name in names] == result["theta"]
        curve, table = json.loads((folder / "curve.json").read_text()), curves[row["id"]]
        for key in ("evaluations", "seconds", "cpu_seconds"):
            assert table[key].tolist() == curve[key]
        assert table["error"].tolist() == list(map(math.sqrt, curve["loss"]))
        for key in ("problem", "optimizer", "seed"):
            assert set(table[key]) == {result[key]}


@pytest.mark.parametrize("name", ["config.json", "environment.json", "curve.json", "result.json"])
@pytest.mark.parametrize("first", ["runs", "curves", "damaged"])
def test_damage_is_known_whichever_table_is_read_first(
    folders: list[Path], name: str, first: str
) -> None:
    path = folders[3] / name
    path.write_bytes(path.read_bytes()[:-1])
    runs = load_runs(folders[0].parents[2])
    getattr(runs, first)
    assert runs.damaged["folder"].tolist() == [str(folders[3])]
    assert 3 not in runs.runs["seed"].tolist()
    assert 3 not in set(runs.curves["seed"])
    assert len(runs.runs) == runs.curves["seed"].nunique() == 11


def test_the_tables_are_of_one_moment(folders: list[Path]) -> None:
    root = folders[0].parents[2]
    expected = load_runs(root).curves
    runs = load_runs(root)
    (folders[0] / "curve.json").unlink()
    runs.runs["id"] = runs.runs["id"].to_numpy()[::-1]
    runs.runs["seed"] = -1
    pd.testing.assert_frame_equal(runs.curves, expected)


def test_settings_that_differ_are_columns_of_both_tables(tmp_path: Path) -> None:
    store, space = Store(tmp_path), DecayFit.space
    for R, n, seed in ((300, 50, 0), (300, 50, 1), (1000, 60, 0)):
        config = {"optimizer": {"R": R, "eta": 5}, "dataset": {"n": n}}
        identity = Identity("decay", "miho", seed, config, code="c0de", data=f"{n}")
        record = minimize(RandomSearch(), DecayFit(), Budget(evaluations=9), seed)
        with store.claim(identity):
            store.commit(identity, record, space, {}, {})
    runs = load_runs(tmp_path)
    assert list(runs.runs.columns[3:6]) == ["seed", "dataset.n", "optimizer.R"]
    keys = ["id", "seed", "optimizer.R", "dataset.n"]
    rows = sorted(runs.runs[keys[1:]].itertuples(index=False, name=None))
    assert rows == [(0, 300, 50), (0, 1000, 60), (1, 300, 50)]
    of_curves = runs.curves[keys].drop_duplicates().sort_values("id", ignore_index=True)
    of_runs = runs.runs[keys].sort_values("id", ignore_index=True)
    pd.testing.assert_frame_equal(of_curves, of_runs)


def test_an_empty_root_has_the_columns(tmp_path: Path) -> None:
    runs = load_runs(tmp_path)
    assert runs.runs.empty
    assert runs.curves.empty
    assert runs.damaged.empty
    assert {"id", "error", "folder"} <= set(runs.runs)
    assert {"id", "seed", "evaluations", "error"} <= set(runs.curves)


@pytest.mark.parametrize("level", ["problem", "optimizer", "id"])
def test_links_out_of_the_root_are_not_followed(folders: list[Path], level: str) -> None:
    outside = folders[0].parents[2]
    root = outside.with_name("other")
    target = {"problem": folders[0].parents[1], "optimizer": folders[0].parent, "id": folders[0]}
    link = root / target[level].relative_to(outside)
    link.parent.mkdir(parents=True)
    link.symlink_to(target[level])
    (root / "nowhere").symlink_to(root / "absent")
    runs = load_runs(root)
    assert runs.runs.empty
    assert runs.damaged["folder"].tolist() == [str(link)]
    assert "symbolic link" in runs.damaged["reason"][0]


@pytest.mark.parametrize("name", ["config.json", "result.json"])
def test_linked_files_are_not_followed(folders: list[Path], name: str) -> None:
    path = folders[0] / name
    path.rename(path.with_name("moved"))
    path.symlink_to(path.with_name("moved"))
    runs = load_runs(folders[0].parents[2])
    assert runs.damaged["folder"].tolist() == [str(folders[0])]
    assert len(runs.runs) == 11


def test_hidden_folders_and_unfinished_runs_are_left_out(folders: list[Path]) -> None:
    root = folders[0].parents[2]
    folders[0].parents[1].rename(root / ".hidden")
    (folders[1] / "result.json").unlink()
    (root / "comparison.json").write_text("{}")
    runs = load_runs(root)
    assert runs.damaged.empty
    assert sorted(runs.runs["seed"]) == [2, 3, 4, 5, 6, 7, 8, 9, 11]


@pytest.mark.parametrize("call", ["scandir", "open"])
def test_what_cannot_be_read_is_listed(
    folders: list[Path], monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    closed = folders[4].parent if call == "scandir" else folders[4]
    real: Callable[..., Any] = getattr(os, call)

    def refusing(path: Any, *arguments: Any, **settings: Any) -> Any:
        if str(path).startswith(str(closed)):
            raise PermissionError(13, "Permission denied", str(path))
        return real(path, *arguments, **settings)

    monkeypatch.setattr(os, call, refusing)
    runs = load_runs(folders[0].parents[2])
    assert len(runs.runs) == 11
    assert runs.damaged["folder"].tolist() == [str(closed)]
    assert "Permission denied" in runs.damaged["reason"][0]


def test_a_pipe_does_not_hold_the_reader(folders: list[Path]) -> None:
    for name in ("result.json", "curve.json"):
        path = folders[len(name) % 12] / name
        path.unlink()
        os.mkfifo(path)
    assert len(load_runs(folders[0].parents[2]).damaged) == 2


def test_what_is_too_large_is_not_read(
    folders: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    with (folders[0] / "config.json").open("ab") as file:
        file.truncate(2 << 20)
    with (folders[1] / "curve.json").open("ab") as file:
        file.truncate(1 << 20)
    monkeypatch.setattr("miho.study.files.LARGEST", 1 << 19)
    runs = load_runs(folders[0].parents[2])
    assert set(runs.damaged["folder"]) == {str(folders[0]), str(folders[1])}
    assert runs.damaged["reason"].str.contains("json: is larger than").all()


@pytest.mark.parametrize("depth", [60, 900, 100_000])
def test_settings_that_are_deep_are_not_read(folders: list[Path], depth: int) -> None:
    """Whoever composes or shows them would go down into them; brackets in words are none."""
    harmless, deep = (json.dumps({"a": "[" * depth + '"'}), '{"a":' * depth + "1" + "}" * depth)
    for folder, text in zip(folders[:2], (harmless, deep), strict=True):
        (folder / "config.json").write_text(text)
        result = json.loads((folder / "result.json").read_text())
        digests = result["files"] | {"config.json": sha256(text)}
        forge(folder, files=digests)
    runs = load_runs(folders[0].parents[2])
    assert runs.damaged["folder"].tolist() == [str(folders[1])]
    assert "config.json: nested deeper than 50" in runs.damaged["reason"].item()
    with pytest.raises(DamagedRun):
        read_run(folders[1])


@pytest.mark.parametrize(
    "curve",
    [
        [],
        {},
        {"evaluations": [1], "seconds": [1], "cpu_seconds": [1], "loss": []},
        {"evaluations": ["1"], "seconds": [1], "cpu_seconds": [1], "loss": [1]},
        {"evaluations": [10**400], "seconds": [1], "cpu_seconds": [1], "loss": [1]},
        {"evaluations": [1], "seconds": [1], "cpu_seconds": [1], "loss": ["1"]},
        {"evaluations": 1, "seconds": 1, "cpu_seconds": 1, "loss": 1},
    ],
)
def test_what_is_no_curve_is_listed_though_its_checksum_matches(
    folders: list[Path], curve: Any
) -> None:
    forge(folders[5], curve)
    runs = load_runs(folders[0].parents[2])
    assert sorted(set(runs.curves["seed"])) == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11]
    assert len(runs.curves) == 11 * POINTS
    assert runs.damaged["folder"].tolist() == [str(folders[5])]
    assert "contains no curve" in runs.damaged["reason"][0]


@pytest.mark.parametrize(
    "change", [{"loss": "x"}, {"facts": None}, {"parameters": 3}, {"theta": [1.0]}, {"files": []}]
)
def test_what_is_no_result_is_listed_though_its_checksum_matches(
    folders: list[Path], change: dict[str, Any]
) -> None:
    forge(folders[5], **change)
    runs = load_runs(folders[0].parents[2])
    assert len(runs.runs) == runs.curves["seed"].nunique() == 11
    assert runs.damaged["folder"].tolist() == [str(folders[5])]


def test_curves_written_in_another_order_or_without_parameters_are_read(
    folders: list[Path],
) -> None:
    root = folders[0].parents[2]
    expected = load_runs(root).curves
    for folder in folders[:2]:
        curve = json.loads((folder / "curve.json").read_text())
        if folder == folders[0]:
            del curve["theta"]
        forge(folder, dict(sorted(curve.items(), reverse=True)))
    pd.testing.assert_frame_equal(load_runs(root).curves, expected)
