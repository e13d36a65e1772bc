"""R16 is met."""

from pathlib import Path

import pytest

from experiments.faults.secrets import secrets


@pytest.mark.slow
def test_secrets(tmp_path: Path) -> None:
    row = secrets(tmp_path)
    assert row.number == "R16"
    assert row.met, row.measured
