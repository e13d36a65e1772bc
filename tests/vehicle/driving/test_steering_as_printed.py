"""The printed regulator: its model and gains by hand, and what it leaves out."""

from __future__ import annotations

import numpy as np
import pytest

from miho.vehicle.driving.as_printed import INTERVAL, PrintedSteering
from miho.vehicle.driving.path_tracking import SteeringActuator, Weights
from miho.vehicle.driving.segments import Segment, track_of
from miho.vehicle.driving.steering_control import TrackingError
from miho.vehicle.driving.track import Projection
from miho.vehicle.models import Axle
from tests.vehicle.driving.cars import car

VEHICLE = car().vehicle
FRONT = Axle(np.array([12.0, 1.5, 3000, 0.01, 50]), np.array([13.0, 1.4, 3300, -0.02, 80]))
REAR = Axle(np.array([14.0, 1.6, 3900, 0.01, 90]), np.array([15.0, 1.5, 4200, 0.0, 10]))
WEIGHTS = Weights(e_y=1.0, e_psi=2.0, steering=50.0)
CONTROL = PrintedSteering.of(VEHICLE, FRONT, REAR, WEIGHTS)
RING = track_of("ring", [Segment(length=200 * np.pi, curvature=(0.01, 0.01))], step=5.0)


def command(control: PrintedSteering, error: TrackingError, vx: float) -> float:
    return control.command(control.initial, RING, Projection(50.0, error.e_y), error, vx, 0.0)[0]


def test_eq_14_by_hand() -> None:
    """B C D, both tires of an axle: 54000 + 60060 N/rad and 87360 + 94500 N/rad."""
    assert CONTROL.model.C_f == pytest.approx(114060.0)
    assert CONTROL.model.C_r == pytest.approx(181860.0)


@pytest.mark.parametrize("row", [0, 4, 12])
def test_eq_15_by_hand(row: int) -> None:
    """K = B' P / R, P from the stable eigenvectors of the Hamiltonian, in the interval's middle.

    The matrices are written out for 800 kg, 1.70 m, 1.271 m and 850 kg m^2. Eigenvectors of an
    8 x 8 matrix whose entries span some six orders of magnitude are good to about 1e-9.
    """
    v, C_f, C_r = INTERVAL * (row + 0.5), 114060.0, 181860.0
    a22, a23 = -(C_f + C_r) / (800 * v), (C_f + C_r) / 800
    a24 = (C_r * 1.271 - C_f * 1.70) / (800 * v)
    a42, a43 = (C_r * 1.271 - C_f * 1.70) / (850 * v), (C_f * 1.70 - C_r * 1.271) / 850
    a44 = -(C_f * 1.70**2 + C_r * 1.271**2) / (850 * v)
    A = np.array([[0, 1, 0, 0], [0, a22, a23, a24], [0, 0, 0, 1], [0, a42, a43, a44]])
    B = np.array([0, C_f / 800, 0, C_f * 1.70 / 850])
    hamiltonian = np.block([[A, -np.outer(B, B) / 50], [-np.diag([1.0, 0, 2, 0]), -A.T]])
    values, vectors = np.linalg.eig(hamiltonian)
    X = vectors[:, values.real < 0]
    P = (X[4:] @ np.linalg.inv(X[:4])).real
    assert CONTROL.K[row] == pytest.approx(B @ P / 50, rel=1e-6)


def test_the_command_is_the_gain_of_its_interval_times_the_error() -> None:
    error = TrackingError(0.2, -0.1, 0.01, 0.03)
    expected = [-float(np.dot(K, error)) for K in CONTROL.K]
    assert command(CONTROL, error, 20.0) == pytest.approx(expected[4])
    assert command(CONTROL, error, 24.99) == pytest.approx(expected[4])
    assert command(CONTROL, error, 25.0) == pytest.approx(expected[5])
    assert command(CONTROL, error, -1.0) == pytest.approx(expected[0])
    assert command(CONTROL, error, 300.0) == pytest.approx(expected[-1])
    assert len(expected) == 18
    far = TrackingError(-50.0, 0.0, 0.0, 0.0)
    assert command(CONTROL, far, 20.0) == VEHICLE.steering_max


def test_without_an_error_it_goes_straight_on_in_a_bend() -> None:
    still = TrackingError(0.0, 0.0, 0.0, 0.0)
    assert command(CONTROL, still, 20.0) == 0.0
    corrected = car().steering_controller(WEIGHTS)
    turned, _ = corrected.command(corrected.initial, RING, Projection(50.0, 0.0), still, 20.0, 0.0)
    assert turned > 0.03, "L kappa = 0.0297"


@pytest.mark.parametrize(("weight", "stable"), [(100.0, 50.0), (1000.0, 85.0)])
def test_delay_and_lag_of_the_steering_make_it_unstable(weight: float, stable: float) -> None:
    """Poles of the printed gains with the steering of the AV-21; without it they are stable.

    With R = 100 the loop is unstable from 55 m/s on, with R = 1000 it is stable up to 85 m/s. The
    moduli at the speeds asked for are more than 1e-4 from 1.
    """
    known = car()
    sampled = known.steering_controller(Weights()).schedule.sampled
    printed = PrintedSteering.of(
        known.vehicle, known.front, known.rear, Weights(steering=weight), sampled.period
    )

    def radius(vx: float) -> float:
        F, G = sampled.matrices(vx)
        K = np.zeros(G.size)
        K[:4] = printed.K[int(vx / INTERVAL)]
        return float(np.abs(np.linalg.eigvals(F - np.outer(G, K))).max())

    assert max(radius(v) for v in np.arange(5.0, stable + 0.1, 2.5)) < 1
    if weight == 100.0:
        assert min(radius(v) for v in np.arange(57.5, 85.0, 2.5)) > 1
        A, B, _, _ = printed.model.matrices(62.5)
        assert np.linalg.eigvals(A - np.outer(B, printed.K[12])).real.max() < 0
    assert sampled.steering == SteeringActuator(delay=0.04, lag=0.0531)


def test_a_bad_period_is_refused() -> None:
    with pytest.raises(ValueError, match="period is 0"):
        PrintedSteering.of(VEHICLE, FRONT, REAR, WEIGHTS, period=0.0)
