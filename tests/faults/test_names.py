"""R15 is met."""

from pathlib import Path

from experiments.faults.names import names


def test_names(tmp_path: Path) -> None:
    row = names(tmp_path)
    assert row.number == "R15"
    assert row.met, row.measured
