"""Scores of a comparison of trackers: stored, found again, refused, and with calibrated alarms."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from baselines.online import ExtendedKalman, LevelAlarm, tire
from experiments.benchmarks.online_records import arguments, records
from experiments.online import comparison
from experiments.online.comparison import watched
from experiments.online.stored import comparable, identity_of, is_stored, store
from miho.online import TrackerSettings
from miho.study import Identity
from miho.study.manifest import ResumeRefused

TIRE = "baselines.online.tire"


def identity(seed: int = 0, drift: float = 0.01) -> Identity:
    config = {"tracker": {"drift": drift}, "stream": {"_target_": TIRE}, "online": {}}
    stream = tire("jump", seed, seconds=1.0)
    return identity_of("ekf", seed, ExtendedKalman(drift), stream, config)


def test_a_score_is_found_again_by_its_identity(tmp_path: Path) -> None:
    folder = tmp_path / "ekf-0"
    folder.mkdir()
    one = identity()
    assert one.problem == "tire_jump"
    assert not is_stored(folder, one, fresh=False)
    store(folder, one, {"error": 0.01})
    assert is_stored(folder, one, fresh=False)
    other = identity(drift=0.02)
    with pytest.raises(ResumeRefused, match="other code, data, settings or packages; replace it"):
        is_stored(folder, other, fresh=False)
    assert not is_stored(folder, other, fresh=True)
    file = folder / "score.json"
    file.write_text(file.read_text().replace("0.01", "0.02"))
    assert not is_stored(folder, one, fresh=False)


def test_only_scores_of_one_stream_and_code_are_compared(tmp_path: Path) -> None:
    one = identity()
    for name, each in {
        "ekf-0": one,
        "ekf-1": identity(seed=1),
        "ekf-2": replace(one, code="0"),
        "ekf-3": replace(one, config={**one.config, "online": {"period": 1.0}}),
    }.items():
        (tmp_path / name).mkdir()
        store(tmp_path / name, each, {})
    (tmp_path / "ekf-4").mkdir()
    (tmp_path / "ekf-4" / "score.json").write_text("{")
    found, others = comparable(tmp_path, one)
    assert [score["seed"] for score in found] == [0, 1]
    assert others == 3


def test_a_peer_has_the_calibrated_alarm_and_the_tracker_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(comparison, "thresholds", lambda *_: ({"level": 0.05}, "level"))
    stream, method = tire("jump", 1, seconds=14.0, at=12.0), ExtendedKalman(0.02, 0.1)
    run = watched(method.start(**arguments(stream)), "ekf", method, TIRE)
    alarms = [state.alarm for row in stream if (state := run.update(row)).alarm]
    [expected] = records(method, [stream], {"level": LevelAlarm(0.05)})
    np.testing.assert_allclose([alarm.time for alarm in alarms], expected.alarms["level"])
    assert alarms
    own = TrackerSettings()
    tracker = own.start(**arguments(stream))
    assert watched(tracker, "miho", own, TIRE) is tracker


@pytest.mark.slow
def test_a_second_start_of_a_comparison_finds_all_scores(tmp_path: Path) -> None:
    """The table and its origin are those of the stored scores."""
    command = [
        sys.executable, "-m", "experiments.track", "experiment=online_grip", f"root={tmp_path}",
        "stream.seconds=35", "hydra.sweeper.params.seed='0,1'",
        "hydra.sweeper.params.tracker=miho",
    ]  # fmt: skip
    for ending in ("grip fell by", "done before"):
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
        assert done.stdout.count(ending) == 2, done.stdout
    assert "miho" in (tmp_path / "table.txt").read_text()
    about = json.loads((tmp_path / "comparison.json").read_text())
    assert [session["seed"] for session in about["sessions"]] == [0, 1]
    assert {"numpy", "scipy"} <= about["packages"].keys()
