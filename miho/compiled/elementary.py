"""Functions of an expression that runs on NumPy arrays and compiled alike.

Called from Python these are NumPy's. Compiled they are those of `miho.compiled.polynomials`.
"""

from __future__ import annotations

from typing import Any

import numpy as np


def sin(x: Any) -> Any:
    """Sine of x [rad]."""
    return np.sin(x)


def cos(x: Any) -> Any:
    """Cosine of x [rad]."""
    return np.cos(x)


def atan(x: Any) -> Any:
    """Arctangent [rad]."""
    return np.arctan(x)


def where(condition: Any, x: Any, y: Any) -> Any:
    """X where a condition holds, else y."""
    return np.where(condition, x, y)
