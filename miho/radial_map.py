"""Map from a cube to a convex polytope, along the rays from an inner point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miho.quantities import Array

TINY = 1e-100
"""Smallest length of a direction."""
ROUNDING = 1e-9
"""Relative tolerance for points outside a side."""


@dataclass(frozen=True, eq=False)
class RadialMap:
    """One-to-one map from shares (m,) in [-1, 1] to the points of a convex polytope.

    A point is on the ray from `centre` with the direction `width` * share. The largest share in
    magnitude is its distance along the ray, relative to the distance at which the ray leaves the
    polytope. The ray leaves where `sides` @ share first reaches 1. The cost is one matrix product
    for any number of sides.

    Parameters
    ----------
    names, share_names : tuple of str
        Names of the coordinates of a point and of its shares.
    centre, width : ndarray of shape (m,)
        Inner point and scale of the directions.
    sides : ndarray of shape (s, m)
        Scaled normals of the sides.
    texts : tuple of str
        Text of each side's constraint, for messages.
    low, high : ndarray of shape (m,)
        Bounds of the points.
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
        """Return the points (n, m) of shares (n, m)."""
        reach = self._lengths(shares)[0]
        return np.clip(self.centre + self.width * shares * reach[:, None], self.low, self.high)

    def slopes(self, shares: Array) -> Array:
        """Return the derivatives (n, m, m) of the points with respect to shares (n, m)."""
        reach, length = self._lengths(shares)
        rows, largest = np.arange(len(shares)), np.abs(shares).argmax(axis=1)
        bend = -reach[:, None] * self.sides[(shares @ self.sides.T).argmax(axis=1)]
        bend[rows, largest] += np.sign(shares[rows, largest])
        slopes = (shares / length[:, None])[:, :, None] * bend[:, None, :]
        slopes += reach[:, None, None] * np.eye(shares.shape[1])
        return np.asarray(self.width[:, None] * slopes)

    def shares(self, point: Array) -> Array:
        """Return the shares (m,) of a point (m,); raises ValueError if it is outside."""
        direction = (point - self.centre) / self.width
        lengths = self.sides @ direction
        beyond = int(lengths.argmax())
        if not lengths[beyond] <= 1 + ROUNDING:
            values = ", ".join(
                f"{name} = {value:g}"
                for name, value, slope in zip(self.names, point, self.sides[beyond], strict=True)
                if slope
            )
            raise ValueError(f"start: {values} violate {self.texts[beyond]}")
        size = np.abs(direction).max()
        return direction if size < TINY else direction * min(lengths[beyond], 1.0) / size

    def _lengths(self, shares: Array) -> tuple[Array, Array]:
        """Return the reach of rays relative to shares, and max(`sides` @ shares), (n,) each."""
        length = np.maximum((shares @ self.sides.T).max(axis=1), TINY)
        return np.maximum(np.abs(shares).max(axis=1), TINY) / length, length
