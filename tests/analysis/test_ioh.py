from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from miho.analysis.compare.profiles import area_over_curve
from miho.analysis.compare.running_time import hits, running_times
from miho.analysis.export import write_ioh
from tests.analysis.several_problems import random_runs, several


def with_parameters(runs: pd.DataFrame) -> pd.DataFrame:
    """Two parameters for p0, three for the others."""
    return runs.assign(
        **{"theta.B": 1.5, "theta.C": 2.0},
        **{"theta.D": np.where(runs["problem"] == "p0", np.nan, 3.0)},
    )


def rows(path: Path) -> list[list[float]]:
    lines = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
    return [[float(cell) for cell in line] for line in lines if line[0] != "evaluations"]


def test_the_layout_of_a_folder(tmp_path: Path) -> None:
    runs, curves = random_runs(np.random.default_rng(7), problems=2, methods=2, seeds=3)
    folders = write_ioh(with_parameters(runs), curves, tmp_path / "ioh")
    assert [folder.name for folder in folders] == ["m0", "m1"]
    facts = json.loads((folders[1] / "IOHprofiler_f2_p1.json").read_text(encoding="utf-8"))
    assert facts["algorithm"] == {"name": "m1", "info": "error in N"}
    assert (facts["function_id"], facts["function_name"]) == (2, "p1")
    (scenario,) = facts["scenarios"]
    assert scenario["dimension"] == 3
    assert [run["instance"] for run in scenario["runs"]] == [0, 1, 2]
    best = runs[(runs["problem"] == "p1") & (runs["optimizer"] == "m1")]["error"].tolist()
    assert [run["best"]["y"] for run in scenario["runs"]] == best
    assert scenario["runs"][0]["best"]["x"] == [1.5, 2.0, 3.0]
    assert {run["evals"] for run in scenario["runs"]} == {1000}
    text = (folders[1] / scenario["path"]).read_text(encoding="utf-8")
    assert text.count("evaluations raw_y\n1 ") == 3


@pytest.mark.parametrize("group", ["optimizer", "dataset"])
def test_settings_that_are_paths_do_not_lead_out_of_the_folder(tmp_path: Path, group: str) -> None:
    runs, curves = random_runs(np.random.default_rng(7), problems=1, methods=1, seeds=2)
    runs[f"{group}.path"] = ["/../../up", "x"]
    write_ioh(with_parameters(runs), curves, tmp_path / "a" / "ioh")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["ioh"]
    written = {str(path.relative_to(tmp_path / "a" / "ioh")) for path in tmp_path.rglob("*.json")}
    of_path = {"optimizer": "m0 path=_.._.._up/IOHprofiler_f1_p0.json",
               "dataset": "m0/IOHprofiler_f1_p0 path=_.._.._up.json"}  # fmt: skip
    assert of_path[group] in written


def test_evaluations_are_whole_and_begin_at_one(tmp_path: Path) -> None:
    """Parts of the data are rounded up; what nothing finite was seen for is inf."""
    runs, curves = several(
        {"p": {"m": [[(0.2, 9.0), (0.9, 8.0), (3.1, 7.0)], [(5.0, 6.0)], []]}},
        ends={"m": 10.5},
    )
    (folder,) = write_ioh(runs.assign(**{"theta.B": 1.0}), curves, tmp_path)
    (data,) = folder.rglob("*.dat")
    assert rows(data) == [
        [1, 8], [4, 7], [11, 7],
        [1, np.inf], [5, 6], [11, 6],
        [1, np.inf], [11, np.inf],
    ]  # fmt: skip
    facts = json.loads(next(folder.glob("*.json")).read_text(encoding="utf-8"))
    bests = [run["best"] for run in facts["scenarios"][0]["runs"]]
    assert [(best["evals"], best["y"]) for best in bests] == [(4, 7), (5, 6), (1, None)]


def test_a_folder_with_content_is_refused(tmp_path: Path) -> None:
    (tmp_path / "old.json").write_text("{}", encoding="utf-8")
    runs, curves = random_runs(np.random.default_rng(7))
    with pytest.raises(FileExistsError, match="is not empty; pass a new folder"):
        write_ioh(with_parameters(runs), curves, tmp_path)


def load(folder: Path) -> Any:
    manager = pytest.importorskip("iohinspector").DataManager()
    manager.add_folder(str(folder))
    return manager


def theirs(folder: Path, target: float, column: str, problem: str) -> dict[str, float]:
    """iohinspector's figure for one target, by method; failed runs cost the budget of 1000."""
    metrics = pytest.importorskip("iohinspector.metrics")
    data = load(folder).load(monotonic=True, include_meta_data=True)
    table = metrics.aggregate_running_time(
        data.filter(data["function_name"] == problem),
        f_min=target,
        f_max=target,
        eval_max=1000,
    )
    return dict(zip(table["algorithm_name"], table[column], strict=True))


@pytest.mark.slow
def test_expected_running_times_are_those_of_iohinspector(tmp_path: Path) -> None:
    runs, curves = random_runs(np.random.default_rng(7), seeds=8)
    write_ioh(with_parameters(runs), curves, tmp_path)
    reached = hits(runs, curves)
    times = running_times(reached, "evaluations").merge(reached[["problem", "factor", "target"]])
    assert 0 < times["success"].mean() < 1
    for (problem, target), of_target in times.groupby(["problem", "target"]):
        of_target = of_target.drop_duplicates("optimizer").set_index("optimizer")
        ert = theirs(tmp_path, target, "ERT", problem)
        success = theirs(tmp_path, target, "success_ratio", problem)
        for method, row in of_target.iterrows():
            # both are sums of whole numbers over a count
            assert ert[method] == pytest.approx(row["ert"], rel=1e-14)
            assert success[method] == pytest.approx(row["success"], rel=1e-14)


@pytest.mark.slow
def test_runs_without_a_value_are_read(tmp_path: Path) -> None:
    runs, curves = several(
        {"p": {"m": [[], [], [(30.0, 5.0)], []]}}, optimum={"p": 5.0}, ends={"m": 1000.0}
    )
    write_ioh(runs.assign(**{"theta.B": 1.0}), curves, tmp_path)
    assert len(load(tmp_path).overview) == 4
    ert = running_times(hits(runs, curves, (1.1,)), "evaluations")["ert"].item()
    assert theirs(tmp_path, 5.5, "ERT", "p") == {"m": ert}


@pytest.mark.slow
def test_areas_are_those_of_iohinspector(tmp_path: Path) -> None:
    """Runs begin with a gap above 10, so the first evaluation, which it counts, has score 0."""
    metrics = pytest.importorskip("iohinspector.metrics")
    polars = pytest.importorskip("polars")
    runs, curves = random_runs(np.random.default_rng(7))
    write_ioh(with_parameters(runs), curves, tmp_path)
    data = load(tmp_path).load(monotonic=True, include_meta_data=True)
    data = metrics.transform_fval(data.with_columns(polars.col("raw_y") / 10 - 1), lb=1e-3, ub=10.0)
    expected = metrics.get_aocc(data, eval_max=1000).set_index(["function_name", "algorithm_name"])
    areas = area_over_curve(runs, curves, 1000.0).groupby(["problem", "optimizer"])["aocc"].mean()
    for key, area in areas.items():
        assert expected.loc[key, "AOCC"] == pytest.approx(area, rel=1e-12)
