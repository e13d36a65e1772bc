"""Peers of the tracker against closed forms: a linear model, where all of them must agree."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from baselines.online import (
    Bank,
    ChangePointAlarm,
    ExtendedKalman,
    InteractingModels,
    LevelAlarm,
    ModeAlarm,
    Particles,
    RecursiveLeastSquares,
    Stream,
    UnscentedKalman,
    WindowedLeastSquares,
    bicycle,
    tire,
)
from baselines.online.peer import Peer, PeerMethod
from miho import CurveFit, Dataset, Parameter, Space
from miho.models import FunctionModel
from miho.quantities import Array

ROWS, SIGMA = 80, 0.1
PRIOR = {"a": (2.0, 0.5), "b": (1.0, 0.3)}


def line(x, *, a, b):  # type: ignore[no-untyped-def]
    return a * x + b


@pytest.fixture(scope="module")
def data() -> Dataset:
    rng = np.random.default_rng(3)
    x = rng.uniform(-1, 1, ROWS)
    y = 2.3 * x + 0.8 + SIGMA * rng.standard_normal(ROWS)
    return Dataset("line", {"x": x, "y": y}, {"x": "", "y": ""}, "y")


@pytest.fixture(scope="module")
def problem(data: Dataset) -> CurveFit:
    space = Space((Parameter("a", "", -50, 50), Parameter("b", "", -50, 50)))
    return CurveFit(FunctionModel(line), data, space, sigma=SIGMA)


def run(method: PeerMethod, problem: CurveFit, data: Dataset) -> Peer:
    peer = method.start(problem, PRIOR, changes={"a": 0.5})
    peer.update(data)
    return peer


def posterior(
    data: Dataset, weights: Array, deviations: tuple[float, float] = (0.5, 0.3), share: float = 1.0
) -> tuple[Array, Array]:
    """Weighted least squares with a prior of this share of its weight: estimate and covariance."""
    A = np.stack([data["x"], np.ones(len(data))], axis=1)
    start, prior = np.array([2.0, 1.0]), share * np.diag(np.array(deviations) ** -2)
    P = np.linalg.inv(prior + (A.T * weights) @ A / SIGMA**2)
    theta = start + P @ ((A.T * weights) @ (data["y"] - A @ start)) / SIGMA**2
    return np.asarray(theta), np.asarray(P)


def walk(data: Dataset, drift: float, others: float) -> tuple[Array, Array]:
    """The Kalman filter of two random walks, in its textbook form."""
    theta = np.array([2.0, 1.0])
    P, Q = np.diag([0.25, 0.09]), 0.02 * np.diag([(2.0 * drift) ** 2, (0.3 * others) ** 2])
    for x, y in zip(data["x"], data["y"], strict=True):
        P = P + Q
        H = np.array([[x, 1.0]])
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + SIGMA**2)
        theta, P = theta + K @ (y - H @ theta), P - K @ H @ P
    return theta, P


def test_a_masked_value_is_missing(problem: CurveFit, data: Dataset) -> None:
    hidden = np.arange(ROWS) % 7 == 3
    wrong = np.where(hidden, 1e3, data["y"])
    masked, missing = (ExtendedKalman().start(problem, PRIOR) for _ in range(2))
    state = masked.update({"x": data["x"], "y": np.ma.array(wrong, mask=hidden)})
    expected = missing.update({"x": data["x"], "y": np.where(hidden, np.nan, data["y"])})
    assert state.theta.tobytes() == expected.theta.tobytes()


# Digits: the filters differ from the closed form by rounding alone, about 80 rows of 1e-16.
@pytest.mark.parametrize("method", [ExtendedKalman, UnscentedKalman])
def test_kalman_filters_are_exact_on_a_linear_model(
    method: type[ExtendedKalman | UnscentedKalman], problem: CurveFit, data: Dataset
) -> None:
    for drift, others in ((0.0, 0.0), (0.3, 0.2)):
        peer = run(method(drift, others), problem, data)
        theta, P = walk(data, drift, others)
        np.testing.assert_allclose(peer.theta[0], theta, rtol=1e-10)
        np.testing.assert_allclose(peer.covariance[0], P, rtol=1e-9, atol=1e-14)
    still = run(method(0.0, 0.0), problem, data)
    np.testing.assert_allclose(still.theta[0], posterior(data, np.ones(ROWS))[0], rtol=1e-10)


def test_scaled_unscented_points_are_exact_too(problem: CurveFit, data: Dataset) -> None:
    peer = run(UnscentedKalman(0.3, 0.2, alpha=0.5, beta=2.0, kappa=1.0), problem, data)
    np.testing.assert_allclose(peer.theta[0], walk(data, 0.3, 0.2)[0], rtol=1e-9)


def test_one_mode_is_the_extended_filter_and_two_equal_ones_too(
    problem: CurveFit, data: Dataset
) -> None:
    theta, P = walk(data, 0.3, 0.2)
    for drifts in ((0.3,), (0.3, 0.3)):
        peer = run(InteractingModels(drifts, 0.2), problem, data)
        np.testing.assert_allclose(peer.theta[0], theta, rtol=1e-10)
        np.testing.assert_allclose(peer.covariance[0], P, rtol=1e-9, atol=1e-14)


def test_modes_follow_bayes_rule(problem: CurveFit, data: Dataset) -> None:
    """After one row, mode probabilities are the predicted ones times the likelihoods."""
    settings = InteractingModels((0.1, 3.0), 0.2, to_quick=0.01, to_quiet=0.2)
    peer = settings.start(problem, PRIOR, changes={"a": 0.5})
    x, y = 0.9, 5.0
    peer.update({"x": x, "y": y})
    predicted = np.array([0.99, 0.01]) @ np.array([[0.99, 0.01], [0.2, 0.8]])
    likelihood = []
    for drift in settings.drifts:
        S = x**2 * (0.25 + 0.02 * (2 * drift) ** 2) + 0.09 + 0.02 * 0.06**2 + SIGMA**2
        likelihood.append(np.exp(-0.5 * (y - 2 * x - 1) ** 2 / S) / np.sqrt(S))
    share = predicted * likelihood / (predicted @ likelihood)
    assert peer.probability[0] == pytest.approx(share[1], rel=1e-9)


def test_recursive_least_squares_is_weighted_least_squares(
    problem: CurveFit, data: Dataset
) -> None:
    for forgetting in (1.0, 0.95):
        peer = run(RecursiveLeastSquares(forgetting, reach=np.inf), problem, data)
        weights = np.asarray(forgetting ** np.arange(ROWS)[::-1])
        theta, P = posterior(data, weights, share=forgetting**ROWS)
        np.testing.assert_allclose(peer.theta[0], theta, rtol=1e-9)
        np.testing.assert_allclose(peer.covariance[0], P, rtol=1e-8, atol=1e-14)


def test_windows_are_fits_of_their_rows(problem: CurveFit, data: Dataset) -> None:
    """The converged fit on a window is SciPy's, with the same prior and Huber's loss."""
    peer = run(WindowedLeastSquares(30, 20, huber=1.0), problem, data)
    x, y = data["x"][-30:], data["y"][-30:]

    def cost(theta: Array) -> Array:
        size = np.abs(theta[0] * x + theta[1] - y) / SIGMA
        huber = np.sqrt(np.where(size < 1, size**2, 2 * size - 1))
        anchor = (theta - [2.0, 1.0]) / [np.hypot(0.5, 1.0), 0.3]
        return np.concatenate([huber, anchor])

    best = least_squares(cost, [2.0, 1.0], xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    # Reweighting ends at steps below 1e-4 of the sizes (2 and 0.3).
    np.testing.assert_allclose(peer.theta[0], best, atol=5e-4)


def test_all_rows_are_the_batch_fit(problem: CurveFit, data: Dataset) -> None:
    peer = run(WindowedLeastSquares(None, 5, huber=1e9, every=ROWS), problem, data)
    theta, P = posterior(data, np.ones(ROWS), (np.hypot(0.5, 1.0), 0.3))
    np.testing.assert_allclose(peer.theta[0], theta, rtol=1e-10)
    np.testing.assert_allclose(peer.covariance[0], P, rtol=1e-10)


def test_particles_are_near_the_kalman_filter(problem: CurveFit, data: Dataset) -> None:
    peer = run(Particles(4000, 0.3, 0.5), problem, data)
    theta, P = walk(data, 0.3, 0.5)
    # 4,000 particles, resampled some ten times: some percent of a standard deviation.
    assert np.all(np.abs(peer.theta[0] - theta) < 0.2 * np.sqrt(np.diag(P)))
    np.testing.assert_allclose(np.diag(peer.covariance[0]), np.diag(P), rtol=0.25)


def test_the_bank_takes_the_best_configuration(problem: CurveFit, data: Dataset) -> None:
    peer = run(Bank(500, rows=40), problem, data)
    errors = problem.model.predict(peer.thetas[0], data["x"][-40:]) - data["y"][-40:]  # type: ignore[attr-defined]
    best = peer.thetas[0, np.argmin(np.sum(errors**2, axis=1))]  # type: ignore[attr-defined]
    np.testing.assert_array_equal(peer.theta[0], best)


PEERS = [
    ExtendedKalman(),
    ExtendedKalman(resets=True, detector=ChangePointAlarm(3.0)),
    UnscentedKalman(),
    InteractingModels(),
    InteractingModels(guards=True),
    RecursiveLeastSquares(),
    WindowedLeastSquares(20, 3),
    WindowedLeastSquares(None, 3, every=10),
]


def started(method: PeerMethod, stream: Stream) -> Peer:
    return method.start(stream.problem, stream.prior, stream.changes, stream.input_noise)


@pytest.mark.parametrize("method", PEERS, ids=lambda method: type(method).__name__)
@pytest.mark.parametrize("family", [tire, bicycle])
def test_runs_abreast_are_the_single_runs(method: PeerMethod, family) -> None:  # type: ignore[no-untyped-def]
    streams = [family("nan", seed, seconds=2, at=1) for seed in (1, 2)]
    both = method.start_abreast(
        [
            {"problem": s.problem, "prior": s.prior, "changes": s.changes,
             "input_noise": s.input_noise}
            for s in streams
        ]
    )  # fmt: skip
    single = [started(method, stream) for stream in streams]
    rows = [list(stream) for stream in streams]
    outputs = [one.column for one in both.setup.system.outputs]
    for pair in zip(*rows, strict=True):
        both.advance(
            np.array([row["time"] for row in pair]),
            np.array([[row[name] for name in both.setup.columns] for row in pair]),
            np.array([[row[name] for name in outputs] for row in pair]),
        )
        for peer, row in zip(single, pair, strict=True):
            state = peer.update(row)
    # The same operations in another order of the same sums: rounding, amplified over 100 rows.
    for k, peer in enumerate(single):
        np.testing.assert_allclose(both.theta[k], peer.theta[0], rtol=1e-6)
    assert state.names == both.setup.names
    assert np.isfinite(state.intervals()).all()


@pytest.mark.parametrize("detector", [LevelAlarm(0.15), ModeAlarm(2.0), ChangePointAlarm(5.0)])
def test_each_alarm_finds_the_jump_once(detector) -> None:  # type: ignore[no-untyped-def]
    stream = tire("jump", 4, seconds=25, at=20)
    peer = started(InteractingModels((0.003, 0.3), 0.03, guards=True, detector=detector), stream)
    states = [peer.update(row) for row in stream]
    alarms = [state.alarm for state in states if state.alarm is not None]
    assert len(alarms) == 1
    assert alarms[0].parameter == "D"
    assert 0 <= alarms[0].time - 20 < 0.3
    assert alarms[0].after < alarms[0].before
