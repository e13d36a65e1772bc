"""A convex set as a box, along the rays from a point inside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miho.quantities import Array

TINY = 1e-100
"""A length below this is no direction."""
ROUNDING = 1e-9
"""A point this share of the way beyond a side is on it."""


@dataclass(frozen=True, eq=False)
class RadialMap:
    """Shares (m,) from -1 to 1 that stand for the points of a polytope, each for one.

    On the ray from `centre` (m,) with the direction `width` * share, the largest share in magnitude
    says how far along the ray a point is, and 1 is where the ray leaves the polytope. That is where
    `sides` (s, m) @ share reaches 1 first; `texts` (s,) say which side is which. So any
    number of sides costs one product of a matrix, and the cube is filled as the polytope is. A
    point has `names` (m,), from `low` to `high`, and the shares have `names` of their own.
    """

    names: tuple[str, ...]
    share_names: tuple[str, ...]
    centre: Array
    width: Array
    sides: Array
    texts: tuple[str, ...]
    low: Array
    high: Array

    def points(self, shares: Array) -> Array:
        """The points (n, m) of shares (n, m)."""
        reach = self._lengths(shares)[0]
        return np.clip(self.centre + self.width * shares * reach[:, None], self.low, self.high)

    def slopes(self, shares: Array) -> Array:
        """The derivatives (n, m, m) of the points with respect to shares (n, m)."""
        reach, length = self._lengths(shares)
        rows, largest = np.arange(len(shares)), np.abs(shares).argmax(axis=1)
        bend = -reach[:, None] * self.sides[(shares @ self.sides.T).argmax(axis=1)]
        bend[rows, largest] += np.sign(shares[rows, largest])
        slopes = (shares / length[:, None])[:, :, None] * bend[:, None, :]
        slopes += reach[:, None, None] * np.eye(shares.shape[1])
        return np.asarray(self.width[:, None] * slopes)

    def shares(self, point: Array) -> Array:
        """The shares (m,) of a point (m,); raises ValueError for one outside of the polytope."""
        direction = (point - self.centre) / self.width
        lengths = self.sides @ direction
        beyond = int(lengths.argmax())
        if not lengths[beyond] <= 1 + ROUNDING:
            values = ", ".join(
                f"{name} = {value:g}"
                for name, value, slope in zip(self.names, point, self.sides[beyond], strict=True)
                if slope
            )
            raise ValueError(f"start: {values} do not keep {self.texts[beyond]}")
        size = np.abs(direction).max()
        return direction if size < TINY else direction * min(lengths[beyond], 1.0) / size

    def _lengths(self, shares: Array) -> tuple[Array, Array]:
        """How far a ray reaches in units of its shares (n,), and `sides` @ shares at most (n,)."""
        length = np.maximum((shares @ self.sides.T).max(axis=1), TINY)
        return np.maximum(np.abs(shares).max(axis=1), TINY) / length, length
