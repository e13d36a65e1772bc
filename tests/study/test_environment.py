"""What a run records of the environment that its bits depend on."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from experiments.diagnosis.results import arithmetic
from miho.study import environment
from miho.study.environment import ARITHMETIC, environment_stamp


def test_a_stamp_says_what_formulas_run_on(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Without the machine of formulas a loss has other last bits."""
    folders = []
    for name, built in (("with", object()), ("without", None)):
        monkeypatch.setattr(environment, "machine", lambda built=built: built)
        stamp = environment_stamp()
        assert set(ARITHMETIC) <= set(stamp)
        (tmp_path / name).mkdir()
        (tmp_path / name / "environment.json").write_text(json.dumps(stamp), encoding="utf-8")
        folders.append(str(tmp_path / name))
    assert arithmetic(folders[:1]).message.startswith("one CPU")
    assert "2 machines of formulas (1, 1 runs)" in arithmetic(folders).message
