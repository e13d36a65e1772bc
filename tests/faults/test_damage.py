"""R7, small here and whole when slow tests run."""

import json
from pathlib import Path
from typing import Any

import pytest

from experiments.faults.damage import damage
from miho.study import DamagedRun


def test_all_damage_is_detected(tmp_path: Path) -> None:
    row = damage(tmp_path, times=20)
    assert row.met, row.measured
    assert row.measured.startswith("210 of 210 detected")


@pytest.mark.slow
def test_all_damage_is_detected_at_300_places(tmp_path: Path) -> None:
    row = damage(tmp_path)
    assert row.met, row.measured


def test_a_reader_that_checks_nothing_fails_the_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unchecked(folder: str) -> tuple[Any, dict[str, bytes]]:
        try:
            result = json.loads((Path(folder) / "result.json").read_bytes())
        except ValueError as error:
            raise DamagedRun(str(error)) from None
        return result, {name: (Path(folder) / name).read_bytes() for name in result["files"]}

    monkeypatch.setattr("miho.study.scan.read_checked", unchecked)
    assert not damage(tmp_path, times=5).met
