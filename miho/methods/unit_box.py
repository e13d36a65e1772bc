"""Parts of methods: the box scaled to the unit cube, Sobol points, and needs of libraries."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from miho.optim import Oracle, Space
from miho.quantities import Array

UNUSABLE = 1e100
"""The loss of a point without a finite loss; its square and its slope over a step of 1e-8 are
finite."""


@dataclass(frozen=True)
class UnitBox:
    """x in [0, 1]^d for theta in the space's box, linear in the search coordinates."""

    space: Space

    def theta(self, x: Array) -> Array:
        """Parameters in their units (..., d), inside the box despite rounding."""
        low, high = self.space.bounds
        return self.space.clip(self.space.decode(low + (high - low) * x))

    def x(self, theta: Array) -> Array:
        """Position in the unit cube, (..., d)."""
        low, high = self.space.bounds
        return np.clip((self.space.encode(theta) - low) / (high - low), 0.0, 1.0)

    def slope(self, theta: Array) -> Array:
        """d theta / d x, (d,), at parameters theta (d,)."""
        low, high = self.space.bounds
        log = np.array([parameter.scale == "log" for parameter in self.space.parameters])
        return np.where(log, theta, 1.0) * (high - low)


@dataclass
class LossScale:
    """Scale all losses of a run so that the first finite nonzero loss is `level`.

    Libraries have absolute tolerances and temperatures in the unit of the loss. With this scale
    their behaviour does not depend on that unit. The first loss is usually the loss of the first
    common configuration, so all methods have the same scale for a problem and a seed.
    """

    level: float
    factor: float | None = None

    def __call__(self, losses: Array) -> Array:
        """Losses (n,); `UNUSABLE` where they are +inf or too large."""
        if self.factor is None:
            sizes = np.abs(losses[np.isfinite(losses) & (losses != 0)])
            if sizes.size:
                self.factor = self.level / max(float(sizes[0]), 1 / UNUSABLE)
        with np.errstate(over="ignore"):
            return np.minimum(losses * (self.factor or 1.0), UNUSABLE)


class UnitOracle:
    """Losses (n,) of points (n, d) in [0, 1]^d, which scale linearly to search coordinates.

    `start` (n, d) are the first common initial configurations. The first batch must be these points
    and is evaluated exactly there, whatever rounding a library's scaling causes. Losses are scaled
    by `LossScale` to a `level` that suits the library's tolerances.
    """

    def __init__(self, oracle: Oracle, n: int, level: float = 1.0) -> None:
        space = oracle.space
        self._oracle = oracle
        self._box = UnitBox(space)
        self._scale = LossScale(level)
        self._first: Array | None = space.decode(space.initial(n))
        self.start = self._box.x(self._first)

    def __call__(self, x: Array, fidelity: float = 1.0) -> Array:
        """Scaled losses; `UNUSABLE` where the oracle returns +inf."""
        thetas = self._box.theta(x)
        if self._first is not None:
            thetas, self._first = self._first, None
        return self._scale(self._oracle(thetas, fidelity))

    def common(self, n: int) -> Array:
        """The first common initial configurations, (n, d), up to rounding."""
        space = self._oracle.space
        return self._box.x(space.decode(space.initial(n)))

    def fresh(self, n: int, rng: np.random.Generator) -> Array:
        """New draws from the initial distribution, (n, d)."""
        space = self._oracle.space
        return self._box.x(space.decode(space.sample(n, rng)))


class Sobol:
    """A Sobol sequence in d dimensions, scrambled (Owen, 1998) by `rng`.

    Published methods use the unscrambled sequence, with which all repetitions would be the same
    run.
    """

    def __init__(self, d: int, rng: np.random.Generator) -> None:
        from scipy.stats import qmc  # slow to import

        self._engine = qmc.Sobol(d, rng=rng)

    def points(self, n: int) -> Array:
        """The next n points, (n, d)."""
        # SciPy warns if the size of the first batch is not a power of two.
        return np.concatenate((self._engine.random(min(n, 1)), self._engine.random(max(n - 1, 0))))


@contextlib.contextmanager
def global_generator(rng: np.random.Generator) -> Iterator[None]:
    """Seed NumPy's global generator, which some libraries use, and restore it at the end."""
    state = np.random.get_state()  # noqa: NPY002
    np.random.seed(int(rng.integers(2**32)))  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(state)  # noqa: NPY002
