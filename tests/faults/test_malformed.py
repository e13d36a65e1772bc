"""R13 is met."""

from pathlib import Path

import pytest

from experiments.faults.malformed import malformed


@pytest.mark.slow
def test_malformed(tmp_path: Path) -> None:
    row = malformed(tmp_path)
    assert row.number == "R13"
    assert row.met, row.measured
