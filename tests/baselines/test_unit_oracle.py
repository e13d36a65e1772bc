import numpy as np

from miho.methods.unit_box import UNUSABLE, UnitOracle
from miho.optim import Budget, Oracle
from miho.testing import DecayFit


def test_the_first_batch_is_exactly_the_common_start() -> None:
    """0.01 ... 10 on the log scale: the unit box alone would be a rounding away."""
    problem = DecayFit()
    losses = UnitOracle(Oracle(problem, Budget()), 20)
    losses(losses.start)
    expected = problem.space.decode(problem.space.initial(20))
    assert np.array_equal(problem.thetas, expected)
    losses(losses.start)
    assert np.allclose(problem.thetas[20:], expected, rtol=1e-14)


def test_corners_of_the_unit_box_are_corners_of_the_space() -> None:
    problem = DecayFit()
    losses = UnitOracle(Oracle(problem, Budget()), 1)
    losses(losses.start)
    losses(np.array([[0.0, 0.0], [1.0, 1.0]]))
    corners = [problem.space.low, problem.space.high]
    assert np.allclose(problem.thetas[1:], corners, rtol=1e-14, atol=0)
    assert problem.space.contains(np.array(problem.thetas[1:])).all()


def test_an_unusable_loss_is_a_number() -> None:
    problem = DecayFit(lambda thetas, losses: np.full(len(thetas), np.nan))
    losses = UnitOracle(Oracle(problem, Budget()), 3)
    assert losses(losses.start).tolist() == [UNUSABLE] * 3
