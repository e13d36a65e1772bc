"""Scores of online methods on a record whose estimate is known in each row."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hydra.utils import instantiate
from omegaconf import OmegaConf

from baselines.online import ExtendedKalman, LevelAlarm, tire
from experiments.benchmarks.online_methods import CONTENDERS, TRIED, detectors
from experiments.benchmarks.online_records import Record, arguments, records
from miho.quantities import Array

TRACKERS = Path(__file__).parents[2] / "conf" / "tracker"
OTHER_NAMES = {"miho": "tracker", "batch": "batch_ls", "lm_window": "lm"}


@pytest.fixture
def record() -> Record:
    """A jump at 20 s that the estimate follows 0.3 s later, with an interval of 2 %."""
    stream = tire("jump", 1, seconds=30, at=20)
    D = stream.truth["D"]
    late = np.where(stream.clock < 20.3 - 1e-9, D[0], D)[:, None]
    reach = 0.02 * np.abs(late)
    alarms = {"own": np.array([12.0, 20.1, 25.0]), "none": np.array([12.0])}
    return Record(stream, np.arange(len(stream)), late, reach, alarms, {})


def test_delays_errors_and_coverage(record: Record) -> None:
    assert record.delay(0.1) == pytest.approx(0.3)
    assert record.errors(10, 20).max() == 0.0
    assert record.errors(20.2, 20.3).min() == pytest.approx(100 * (1 / 0.65 - 1))
    assert record.coverage(10, 20) == 1.0
    # The fall is outside 2 % from its second row to 0.28 s: 13 of 15 rows or so.
    assert record.coverage(20, 20.3) == pytest.approx(2 / 15, abs=0.07)


def test_a_delay_needs_a_second_within_the_tolerance(record: Record) -> None:
    theta: Array = record.theta.copy()
    theta[1040] *= 2.0  # 0.8 s after the change
    spoilt = Record(record.stream, record.rows, theta, record.reach, {}, {})
    assert spoilt.delay(0.1) == pytest.approx(0.82)


def test_alarms_count_after_the_change(record: Record) -> None:
    assert record.alarm_delay("own") == pytest.approx(0.1)
    assert record.alarm_count("own") == 2
    assert record.alarm_delay("none") == np.inf


def test_lockstep_records_are_those_of_single_updates() -> None:
    streams = [tire("jump", seed, seconds=12, at=11) for seed in (1, 2)]
    method = ExtendedKalman(0.01, 0.1)
    alarm = {"level": LevelAlarm(0.05)}
    for stream, record in zip(streams, records(method, streams, alarm), strict=True):
        run = method.start(**arguments(stream))
        theta = np.array([run.update(row).values["D"] for row in stream])
        np.testing.assert_allclose(record.theta[:, 0], theta, rtol=1e-9)


def test_each_peer_tries_the_same_number_of_settings() -> None:
    for name, contender in CONTENDERS.items():
        assert len(contender.trials()) == (TRIED if contender.grid else 1), name
        assert contender.chosen.keys() == contender.grid.keys()
        assert not contender.grid or contender.chosen in contender.trials(), name
        contender.method()
        assert detectors(contender.detectors, {}).keys() == {*contender.detectors} - {"own"}


@pytest.mark.parametrize("path", sorted(TRACKERS.glob("*.yaml")), ids=lambda path: path.stem)
def test_configurations_are_the_settings_of_the_comparison(path: Path) -> None:
    name = OTHER_NAMES.get(path.stem, path.stem)
    assert instantiate(OmegaConf.load(path)) == CONTENDERS[name].method()
