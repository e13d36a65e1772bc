"""What a user sees before the search: the data as they were read, and how long it will take."""

from pathlib import Path

import pytest

from experiments.app.build import build
from experiments.app.compose import composed
from experiments.app.forecast import announce, forecast, seconds_of_evaluation
from miho.optim import Budget

ROWS = {"every": 1, "where": None}


@pytest.mark.parametrize(
    ("budget", "seconds", "settings", "text"),
    [
        (
            Budget(500_000, 60.0), 1e-5, ROWS,
            "60,000 rows, 10 µs an evaluation: at most 5 s for the 500,000 allowed",
        ),
        (
            Budget(500_000, 60.0), 4e-3, ROWS,
            "60,000 rows, 4 ms an evaluation: at most 2e+03 s for the 500,000 allowed, but "
            "budget.seconds=60 ends it after some 15,000; fewer rows are faster: "
            "dataset.every=10 or 'dataset.where={COLUMN: [FROM, TO]}'",
        ),
        (
            Budget(500_000), 4e-3, {"every": 1},
            "60,000 rows, 4 ms an evaluation: at most 2e+03 s for the 500,000 allowed; fewer rows "
            "are faster: dataset.every=10",
        ),
        (
            Budget(seconds=5.0), 0.2, {},
            "60,000 rows, 200 ms an evaluation: at most 25 in the 5 s allowed",
        ),
    ],
)  # fmt: skip
def test_what_it_will_take(
    budget: Budget, seconds: float, settings: dict[str, object], text: str
) -> None:
    assert forecast(seconds, budget, 60_000, settings) == text


def test_own_data_are_announced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.csv"
    path.write_text("alpha,Fy\n" + "\n".join(f"{i / 100},{-i}" for i in range(20)))
    cfg = composed(["dataset=csv", f"dataset.path={path}", f"root={tmp_path}"])
    experiment = build(cfg)
    announce(experiment, cfg.dataset)
    printed = capsys.readouterr().err
    assert printed.startswith(f"{path}: 20 rows; name, unit, range, first rows:\n  alpha  rad ")
    assert "20 rows, " in printed.splitlines()[-1]
    assert 0 < seconds_of_evaluation(experiment.problem) < 1.0
    cfg = composed([f"root={tmp_path}"])
    announce(build(cfg), cfg.dataset)
    assert capsys.readouterr() == ("", "")
