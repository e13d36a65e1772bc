"""Streams have the truth that they state, and differ by their seed alone."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.online import Stream, bicycle, longitudinal, tire
from baselines.online.bicycle import KINDS as OF_CAR
from baselines.online.streams import KINDS, SUDDEN

SHORT = {"seconds": 12.0, "at": 6.0}


def residuals(stream: Stream) -> list[np.ndarray]:
    """Errors of each output at the true parameters, in its standard deviations."""
    each = []
    for problem in stream.problem:
        names = list(problem.model.parameters)
        inputs = [stream.columns[name] for name in problem.model.inputs]
        predicted = np.array(
            [
                problem.model.predict(np.array([theta]), *(column[k : k + 1] for column in inputs))
                for k, theta in enumerate(zip(*(stream.truth[n] for n in names), strict=True))
            ]
        ).ravel()
        each.append((stream.columns[problem.dataset.output] - predicted) / problem.scale)
    return each


@pytest.mark.parametrize("kind", ["none", "jump", "ramp", "stiffness"])
def test_the_truth_explains_the_force(kind: str) -> None:
    (errors,) = residuals(tire(kind, 5, **SHORT))
    # 600 rows of noise, and of the slip angle's noise: a standard deviation within some 10 %.
    assert 0.9 < errors.std() < 1.3
    assert abs(errors.mean()) < 0.25


def test_the_truth_explains_the_motion() -> None:
    for errors in residuals(bicycle("jump", 5, **SHORT)):
        # The state before and after the step has noise: at least the square root of 2.
        assert 1.2 < errors.std() < 1.7
        assert abs(errors.mean()) < 0.25


@pytest.mark.parametrize("kind", ["none", "mass", "brake_gain", "drag"])
def test_the_truth_explains_the_acceleration(kind: str) -> None:
    stream = longitudinal(kind, 5, seconds=40, at=20, drop=0.2)
    (errors,) = residuals(stream)
    assert 0.9 < errors.std() < 1.1  # 2,000 rows of noise alone
    ends = {name: truth[-1] / truth[0] for name, truth in stream.truth.items()}
    assert ends == {name: pytest.approx(0.8 if name == kind else 1.0) for name in ends}
    assert np.ptp(stream.columns["speed"]) > 20
    assert stream.columns["pressure"].max() > 0


def test_the_grip_falls_as_stated() -> None:
    for make, names in ((tire, ["D"]), (bicycle, ["D_f", "D_r"])):
        for kind, middle in (("jump", 0.1), ("ramp", 5.0)):
            stream = make(kind, 2, seconds=30, at=10, drop=0.4)
            for name in names:
                truth = stream.truth[name]
                share = np.interp([9.9, 10 + middle, 25.0], stream.clock, truth / truth[0])
                np.testing.assert_allclose(share, [1, 0.8, 0.6], atol=0.02)


def test_a_seed_is_a_stream() -> None:
    for make in (tire, bicycle):
        first, same, other = (make("jump", seed, **SHORT) for seed in (1, 1, 2))
        for name, column in first.columns.items():
            np.testing.assert_array_equal(column, same.columns[name])
        assert first.prior == same.prior != other.prior
        assert len(list(first)) == len(first) == 600


def test_faults_are_as_described() -> None:
    rows = {kind: tire(kind, 3, **SHORT) for kind in KINDS}
    fault = rows["none"].during(6, 11)
    assert np.isnan(rows["dropout"].columns["Fy"][fault]).all()
    assert np.unique(rows["frozen"].columns["Fy"][fault]).size == 1
    assert len(rows["missing"]) == 600 - 250
    assert 0.05 < np.isnan(rows["nan"].columns["alpha"]).mean() < 0.15
    steps = np.diff(rows["time"].columns["time"])
    np.testing.assert_allclose([steps.max(), steps.min()], [10.02, -4.98], atol=1e-9)
    np.testing.assert_array_equal(
        rows["delay"].columns["alpha"][1:], rows["none"].columns["alpha"][:-1]
    )
    far = np.abs(residuals(rows["outliers"])[0]) > 10
    assert 0.005 < far.mean() < 0.04


def test_each_kind_has_the_times_of_its_change() -> None:
    for kind in KINDS:
        stream = tire(kind, 1, **SHORT)
        assert (stream.start == 6.0) == (kind in (*SUDDEN, "ramp", "dropout", "missing",
                                                  "frozen", "time"))  # fmt: skip
    for kind in OF_CAR:
        assert len(bicycle(kind, 1, seconds=1, at=0.5)) > 20
    with pytest.raises(ValueError, match="kind"):
        tire("wet", 1)
