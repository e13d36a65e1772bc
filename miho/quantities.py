"""Array types and the acceleration of gravity, shared by all packages."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

g = 9.80665
"""Standard acceleration of gravity [m/s^2]."""
