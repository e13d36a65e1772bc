"""R7: files of runs that were cut, altered, overwritten with zeros or exchanged.

Small when quick tests run, whole among the slow ones.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from miho.study import DamagedRun, Runs, load_runs
from miho.study.files import CONFIG, CURVE, ENVIRONMENT, RESULT
from tests.faults.conftest import Figures
from tests.faults.stored_runs import make_runs

TIMES, FEWER_TIMES = 300, 20
WHOLE = 10
TAIL = 64
KINDS = (RESULT, CURVE, CONFIG, ENVIRONMENT)


@pytest.mark.slow
@pytest.mark.fault(
    row="R7",
    fault=f"4 kinds of file: cut at {TIMES} places, {TIMES} bits flipped, tail zeroed, exchanged",
    promise="all detected, all other runs read, no wrong number",
)
def test_damage(tmp_path: Path, measured: Figures) -> None:
    detected, tried, right = damage(tmp_path, TIMES)
    others = "right" if right == len(KINDS) else f"wrong in {len(KINDS) - right} of {len(KINDS)}"
    measured(f"{detected:,} of {tried:,} detected, the others read {others}")
    assert detected == tried
    assert right == len(KINDS)


def test_less_damage(tmp_path: Path) -> None:
    assert damage(tmp_path, FEWER_TIMES) == (168, 168, len(KINDS))


def test_a_reader_that_checks_nothing_fails_the_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unchecked(folder: str) -> tuple[Any, dict[str, bytes]]:
        try:
            result = json.loads((Path(folder) / "result.json").read_bytes())
        except ValueError as error:
            raise DamagedRun(str(error)) from None
        return result, {name: (Path(folder) / name).read_bytes() for name in result["files"]}

    monkeypatch.setattr("miho.study.index.read_checked", unchecked)
    detected, tried, right = damage(tmp_path, times=5)
    assert detected < tried or right < len(KINDS)


def damage(folder: Path, times: int) -> tuple[int, int, int]:
    """Spoil each kind of file in many ways, each in a run of its own, and read them all.

    How many damages are detected, of how many, and after how many of `KINDS` the others are read
    right.
    """
    rng = np.random.default_rng(0)
    ways = 2 * times + 2
    folders = make_runs(folder / "runs", ways + WHOLE, rng)
    expected = load_runs(folder / "runs")
    detected, right = 0, 0
    for name in KINDS:
        other = (folders[-1] / name).read_bytes()
        good = [(run / name).read_bytes() for run in folders[:ways]]
        for way, data in enumerate(good):
            (folders[way] / name).write_bytes(_spoilt(data, other, way, times, rng))
        stored = load_runs(folder / "runs")
        listed = stored.damaged[stored.damaged["reason"] != ""]["folder"]
        detected += len({str(run) for run in folders[:ways]} & set(listed))
        right += len(stored.runs) == WHOLE and _agrees(stored, expected)
        for run, data in zip(folders, good, strict=False):
            (run / name).write_bytes(data)
    return detected, 4 * ways, right


def _spoilt(good: bytes, other: bytes, way: int, times: int, rng: np.random.Generator) -> bytes:
    if way < times:
        return good[: len(good) * way // times]
    if way < 2 * times:
        position, bit = int(rng.integers(len(good))), int(rng.integers(8))
        return good[:position] + bytes([good[position] ^ 1 << bit]) + good[position + 1 :]
    return good[:-TAIL] + bytes(TAIL) if way == 2 * times else other


def _agrees(found: Runs, expected: Runs) -> bool:
    """Whether the runs that were found have the numbers that are expected of them."""
    return all(
        after.equals(before[before["id"].isin(found.runs["id"])].reset_index(drop=True))
        for after, before in ((found.runs, expected.runs), (found.curves, expected.curves))
    )
