"""The curves that are fitted in wide boxes, and what counts as right."""

import numpy as np
import pytest

from experiments.check.wide_boxes import CURVES, RIGHT


@pytest.mark.parametrize("name", CURVES)
def test_the_best_loss_is_below_that_of_the_true_parameters(name: str) -> None:
    """By more than counts as right: the true curve's own loss would pass a wrong optimum."""
    curve = CURVES[name]
    losses = []
    for times in (10.0, 1e6):
        fit = curve.fit(times)
        losses.append(curve.best(fit))
        assert (1 + RIGHT) * losses[-1] < float(fit.loss(np.array([curve.true], dtype=float))[0])
    assert losses[0] == pytest.approx(losses[1], rel=RIGHT / 10), "whatever the box"
