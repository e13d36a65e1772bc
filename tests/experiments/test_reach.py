"""What the benchmark says of runs whose traces are written down here."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from experiments.app.build import ConfigError
from experiments.app.options import source
from experiments.benchmarks import reach
from experiments.benchmarks.reach import DEFAULT, problems, variants, widened
from experiments.benchmarks.reach_tables import (
    Run,
    geometric_means,
    hits,
    reach_table,
    solved_by_all,
    stopping_table,
)
from miho.optim import Parameter, Space
from miho.optim.minimize import Outcome


def run(
    improvements: list[tuple[float, float]],
    evaluations: float,
    outcome: Outcome = Outcome.BUDGET,
    problem: str = "p",
    variant: str = DEFAULT,
    seed: int = 0,
) -> Run:
    """A run on a problem whose optimum is an error of 10: evaluations and error, 2 ms each."""
    at, errors = np.array(improvements, dtype=float).reshape(-1, 2).T
    return Run(
        problem, variant, seed, 10.0, outcome, evaluations, 0.002 * evaluations, at, 0.002 * at,
        errors**2,
    )  # fmt: skip


def only(table: pd.DataFrame) -> dict[str, Any]:
    """The one row of a table."""
    (row,) = table.to_dict("records")
    return {str(name): value for name, value in row.items()}


def three() -> list[Run]:
    """At 1.01 after 40 and 100 evaluations, and never in 500; at 1.001 after 60, never, never."""
    return [
        run([(5, 15.0), (40, 10.1), (60, 10.005)], 60, seed=0),
        run([(80, 14.0), (100, 10.05)], 200, seed=1),
        run([(7, 12.0)], 500, seed=2),
    ]


def test_running_times_charge_the_failures_and_quantiles_are_of_runs() -> None:
    row = only(reach_table(hits(three())))
    assert row["1.5"] == (5 + 80 + 7) / 3
    assert row["1.1"] == row["1.01"] == (40 + 100 + 500) / 2
    assert row["1.001"] == 60 + 200 + 500
    assert row["success"] == 1 / 3
    assert [row[name] for name in ("median", "90 %", "largest")] == [np.inf] * 3
    assert row["ms"] == pytest.approx(200.0)  # of 80, 200 and inf


def test_quantiles_are_evaluations_of_single_runs() -> None:
    runs = [run([(k, 10.0)], k, seed=k) for k in range(1, 11)]
    row = only(reach_table(hits(runs)))
    assert [row[name] for name in ("median", "90 %", "largest")] == [5, 9, 10]


def test_geometric_means_are_over_problems_and_say_what_is_unsolved() -> None:
    runs = [
        run([(4, 10.0)], 4, problem="z"),
        run([(8, 10.0)], 8, problem="z", variant="x=2"),
        run([(100, 10.0)], 100, problem="a"),
        run([(3, 11.0)], 100, problem="a", variant="x=2"),
    ]
    table = reach_table(hits(runs))
    assert table.index.tolist() == [("z", DEFAULT), ("z", "x=2"), ("a", DEFAULT), ("a", "x=2")]
    assert set(solved_by_all(table).index.get_level_values("problem")) == {"z"}
    means = geometric_means(table)
    assert means.index.tolist() == [DEFAULT, "x=2"]
    whole, changed = means.to_dict("records")
    assert whole["1.001"] == pytest.approx(20.0)
    assert whole["ms"] == pytest.approx(40.0)
    assert (whole["least success"], whole["unsolved"]) == (1, 0)
    assert changed["1.1"] == pytest.approx(np.sqrt(8 * 3))
    assert changed["1.01"] == np.inf
    assert (changed["least success"], changed["unsolved"]) == (0, 1)


def test_a_run_that_ends_is_charged_from_where_its_loss_was_the_last_one() -> None:
    """10.0004 is 8e-5 of the loss above 10, thus arrived; 10.1 is not the optimum."""
    converged = Outcome.CONVERGED
    runs = [
        run([(1, 20.0), (10, 10.0004), (90, 10.0)], 40, converged, seed=0),
        run([(20, 10.1)], 30, converged, seed=1),
        run([(20, 10.0)], 500, Outcome.BUDGET, seed=2),
        run([], 3, Outcome.NO_FINITE_VALUE, seed=3),
    ]
    assert [one.overrun for one in runs[:3]] == [4.0, 1.5, 25.0]
    assert np.isnan(runs[3].overrun)
    assert [one.at_optimum for one in runs] == [True, False, True, False]
    assert runs[1].excess == pytest.approx(0.01)
    row = only(stopping_table(runs))
    assert (row["runs"], row["ended"], row["at optimum"]) == (4, 0.5, 0.25)
    assert (row["median"], row["largest"]) == (1.5, 4.0)


def test_a_variant_changes_one_setting_and_another_method_drops_them() -> None:
    found = variants(
        ["optimizer=a", "optimizer.b=1"],
        ["steps=2,3", "optimizer.scale=0.5"],
        ["optimizer.b=2 optimizer.c=[1,2]", "optimizer=z"],
    )
    base = ("optimizer=a", "optimizer.b=1")
    assert found == {
        DEFAULT: base,
        "steps=2": (*base, "optimizer.steps=2"),
        "steps=3": (*base, "optimizer.steps=3"),
        "scale=0.5": (*base, "optimizer.scale=0.5"),
        "b=2 c=[1,2]": (*base, "optimizer.b=2", "optimizer.c=[1,2]"),
        "z": ("optimizer=z",),
    }
    with pytest.raises(ConfigError, match=r"budget\.seconds: is no setting of the method"):
        variants(base, [], ["budget.seconds=1"])


def test_problems_are_named_once_in_the_order_given() -> None:
    assert problems("tire_lf,sample_b_*,*_lf") == ["tire_lf", "sample_b_physical", "sample_b_wide"]
    assert {"tire_lf", "single_track"} <= set(problems(None))
    with pytest.raises(ConfigError, match="--problems=tire_xx: is unknown; the closest"):
        problems("tire_lf,tire_xx")


def call(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int | str | None:
    monkeypatch.setattr("sys.argv", ["reach", *arguments])
    with pytest.raises(SystemExit) as ended:
        reach.main()
    return ended.value.code


def test_it_runs_and_writes_what_regenerates_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Projection solves a linear model at once: 4 parameters, 5 looks and one that records it."""
    path = tmp_path / "torque.csv"
    code = call(
        monkeypatch, "optimizer=least_squares", "optimizer.screen=20", "--problems", "torque_05",
        "--seeds", "6", "--first", "3", "--with", "optimizer=variable_projection",
        "--out", str(path),
    )  # fmt: skip
    printed = capsys.readouterr().out
    assert code == 0, printed
    frame = pd.read_csv(path)
    assert len(frame) == 2 * 6 * 4
    assert set(frame["seed"]) == set(range(3, 9))
    assert frame["reached"].all()
    projected = frame[frame["variant"] == "variable_projection"]
    assert set(projected["evaluations"]) == {6}
    about = json.loads(path.with_suffix(".provenance.json").read_text())
    assert about["variants"]["variable_projection"] == ["optimizer=variable_projection"]
    assert about["variants"][DEFAULT] == ["optimizer=least_squares", "optimizer.screen=20"]
    last = printed.splitlines()[-1].split()
    assert last[:5] == ["variable_projection", "6", "6", "6", "6"]


def test_problems_and_methods_of_a_further_folder(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    texts = {
        "problem/mine": source("problem", "torque_05"),
        "optimizer/own": source("optimizer", "variable_projection"),
    }
    for name, text in texts.items():
        path = tmp_path / "own" / f"{name}.yaml"
        path.parent.mkdir(parents=True)
        path.write_text(text.replace("name: torque_05", "name: mine"), encoding="utf-8")
    arguments = ("optimizer=own", "--problems", "min?", "--seeds", "2")
    assert call(monkeypatch, *arguments) == 2
    assert "optimizer=own: is unknown" in capsys.readouterr().err
    assert call(monkeypatch, *arguments, "--config-dir", str(tmp_path / "own")) == 0
    assert capsys.readouterr().out.splitlines()[2].split()[:5] == ["mine", "6", "6", "6", "6"]
    assert call(monkeypatch, *arguments, "--config-dir", str(tmp_path / "none")) == 2
    assert "none is not a folder" in capsys.readouterr().err


@pytest.mark.slow
def test_two_processes_tell_what_one_tells(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    frames = []
    for processes in ("1", "2"):
        path = tmp_path / f"{processes}.csv"
        code = call(
            monkeypatch, "optimizer=least_squares", "--problems", "torque_05,torque_15",
            "--seeds", "7", "--processes", processes, "--vary", "starts=1,2", "--out", str(path),
        )  # fmt: skip
        assert code == 0, capsys.readouterr().err
        frames.append(pd.read_csv(path).drop(columns=["seconds", "spent_seconds"]))
    pd.testing.assert_frame_equal(frames[0], frames[1])
    assert len(frames[0]) == 2 * 3 * 7 * 4


def test_a_method_that_ends_is_found_where_it_ended(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One look too many for the linear solve; one random point ends, and not at the optimum."""
    arguments = ("--stopping", "--problems", "torque_05", "--seeds", "2")
    assert call(monkeypatch, "optimizer=variable_projection", *arguments) == 0
    assert capsys.readouterr().out.splitlines()[-1].split()[:4] == ["all", "2", "1", "1"]
    assert call(monkeypatch, "optimizer=random", "budget.evaluations=30", *arguments) == 0
    assert capsys.readouterr().out.splitlines()[-1].split()[:4] == ["all", "2", "0", "0"]


def test_what_cannot_be_run_is_said_before_anything_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for arguments, message in {
        ("problem=tire_lf",): "problem: cannot be chosen here; see --problems",
        ("seed=3",): "seed: cannot be chosen here; see --seeds",
        ("--vary", "R=3"): "optimizer",
        ("optimizer=nothing_like_it",): "nothing_like_it",
    }.items():
        assert call(monkeypatch, "optimizer=least_squares", *arguments) == 2
        assert message in capsys.readouterr().err
    assert call(monkeypatch, "--seeds", "0") == 2


def test_a_wider_box_has_its_middle_where_it_was() -> None:
    space = Space([Parameter("a", "V", -1.0, 3.0), Parameter("b", "V", 1e-2, 1e2, scale="log")])
    wide = widened(space, 30)
    np.testing.assert_allclose(wide.low, [-59, 1e-2 / 30])
    np.testing.assert_allclose(wide.high, [61, 3e3])
    assert widened(space, 1) == space
