"""A check of models: batches, derivatives and declared linear parameters."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np

from miho.models import Model
from miho.quantities import Array


class ConformanceError(AssertionError):
    """A failed check: its name and the observation."""


def require(condition: bool, message: str) -> None:
    """Raise ConformanceError with this message unless the condition is true."""
    if not condition:
        raise ConformanceError(message)


def check_model(model: Model, thetas: Array, *inputs: Array) -> None:
    """Check a model at parameter rows (n, d) and input columns (N,).

    A row must have the same value in any batch. `jacobian` must be the derivative of `predict`, by
    central differences to 1e-6 of each column's range. The output must be jointly linear in the
    parameters that `linear` names.

    Parameters
    ----------
    model : Model
        The model.
    thetas : ndarray of shape (n, d)
        Parameters.
    *inputs : ndarray of shape (N,)
        Input columns.

    Raises
    ------
    ConformanceError
        If a check fails.

    Examples
    --------
    >>> import numpy as np
    >>> from miho.testing import check_model
    >>> from miho.vehicle.models import Pacejka
    >>> alpha = np.linspace(-0.2, 0.2, 9)
    >>> check_model(Pacejka(), np.array([[10.0, 1.5, 4000.0, 0.0, 50.0]]), alpha)
    """
    batch = model.predict(thetas, *inputs)
    for theta, row in zip(thetas, batch, strict=True):
        alone = model.predict(theta[None], *inputs)[0]
        require(np.array_equal(alone, row), f"predict at {theta} depends on the batch")
        jacobian = model.jacobian(theta, *inputs)
        for k, name in enumerate(model.parameters):
            h = 1e-6 * max(abs(theta[k]), 1e-3) * (np.arange(theta.size) == k)
            ahead, behind = model.predict(np.stack([theta + h, theta - h]), *inputs)
            difference = (ahead - behind) / (2 * h[k])
            close = 1e-6 * max(np.ptp(difference), np.abs(difference).max())
            require(
                bool(np.allclose(jacobian[:, k], difference, rtol=1e-5, atol=close)),
                f"jacobian with respect to {name} is not the derivative of predict at {theta}",
            )
        _check_linear(model, theta, *inputs)


def _check_linear(model: Model, theta: Array, *inputs: Array) -> None:
    """Check that second differences in all pairs of linear parameters vanish."""
    names = list(model.parameters)
    for name in model.linear:
        require(name in names, f"linear names {name!r}; parameters are {', '.join(names)}")
    steps = np.diag(np.where(theta == 0, 1.0, theta))
    for first, second in combinations_with_replacement(model.linear, 2):
        h, k = steps[names.index(first)], steps[names.index(second)]
        at_both, at_first, at_second, at_none = model.predict(
            np.stack([theta + h + k, theta + h, theta + k, theta]), *inputs
        )
        size = max(np.abs(row).max() for row in (at_both, at_first, at_second, at_none))
        require(
            bool(np.abs(at_both - at_first - at_second + at_none).max() <= 1e-9 * size),
            f"linear names {first} and {second}, but predict is not linear in them at {theta}",
        )
