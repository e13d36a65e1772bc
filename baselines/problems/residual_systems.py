"""Models of published systems of residuals, by name and length."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice

import numpy as np

from baselines.problems import cartis_roberts, discretized, more_wild
from baselines.problems.records import System
from miho.models.model import Model
from miho.quantities import Array
from miho.validate import one_of, whole

SYSTEMS: Mapping[str, System] = {
    **more_wild.SYSTEMS, **cartis_roberts.SYSTEMS, **discretized.SYSTEMS
}  # fmt: skip
STEP = 1e-30
"""Size of the complex step; its square is below the rounding error of numbers of usual size."""
LONGEST = 100
"""Lengths up to this one are tried for an error message."""


@dataclass(frozen=True)
class ResidualSystem(Model):
    """A published system of residuals of `length` variables, without units.

    Parameters are x1, x2, .... The input `row` is the number of a residual, from 1. The output is
    the residual, so the data are zeros (`zero_residuals`). A row is one equation and may
    depend on all variables. Derivatives by the complex step are exact up to rounding (Squire and
    Trapp, SIAM Review 40, 1998).

    Parameters
    ----------
    system : str
        One of `SYSTEMS`.
    length : int
        Number of variables n. Some systems exist for some lengths only.

    Raises
    ------
    ValueError
        If there is no such system, or none of this length.

    Examples
    --------
    >>> import numpy as np
    >>> from baselines.problems import ResidualSystem
    >>> system = ResidualSystem("rosenbrock", 2)
    >>> system.predict(system.start[None], np.array([1.0, 2.0])).round(6).tolist()
    [[-4.4, 2.2]]
    """

    system: str
    length: int

    inputs = {"row": "-"}  # noqa: RUF012
    output = "-"

    def __post_init__(self) -> None:
        one_of("system", self.system, SYSTEMS)
        whole("length", self.length, 1)
        if not _has_length(self.published, self.length):
            lengths = (n for n in range(1, LONGEST + 1) if _has_length(self.published, n))
            some = ", ".join(map(str, islice(lengths, 5)))
            raise ValueError(f"length is {self.length}; {self.system} has lengths such as {some}")

    @property
    def name(self) -> str:
        """The system and its length."""
        return f"{self.system}_{self.length}"

    @property
    def published(self) -> System:
        """The formulas with the published start."""
        return SYSTEMS[self.system]

    @property
    def size(self) -> int:
        """Number of residuals."""
        return self.published.size(self.length)

    @property
    def start(self) -> Array:
        """The published start (n,)."""
        return np.array(self.published.start(self.length), dtype=float)

    @property
    def parameters(self) -> Mapping[str, str]:
        """x1, x2, ..."""
        return {f"x{number}": "-" for number in range(1, self.length + 1)}

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Residuals at parameter rows.

        Parameters
        ----------
        thetas : ndarray of shape (n, d)
            Parameter rows.
        *inputs : ndarray of shape (N,)
            Numbers of the residuals, from 1: the column `row`.

        Returns
        -------
        ndarray of shape (n, N)
            Residuals.
        """
        (row,) = inputs
        if row.size and row.max() > self.size:
            raise ValueError(f"row is {row.max():g}; {self.name} has the rows 1 to {self.size}")
        return self._residuals(thetas)[:, row.astype(int) - 1]

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the residuals at one configuration.

        Parameters
        ----------
        theta : ndarray of shape (d,)
            Parameters.
        *inputs : ndarray of shape (N,)
            Numbers of the residuals, from 1: the column `row`.

        Returns
        -------
        ndarray of shape (N, d)
            Derivatives.
        """
        (row,) = inputs
        moved = theta + 1j * STEP * np.eye(theta.size)
        return np.asarray(self._residuals(moved).imag.T[row.astype(int) - 1] / STEP)

    def _residuals(self, thetas: Array) -> Array:
        """All residuals (n, m) of parameter rows (n, d); NaN or infinite without a value."""
        with np.errstate(all="ignore"):
            return np.asarray(self.published.residuals(np.ascontiguousarray(thetas.T), self.size).T)


def _has_length(system: System, length: int) -> bool:
    """Whether a system has a start and residuals of this number of variables."""
    try:
        start = np.tile(np.array(system.start(length), dtype=float)[:, None], 2)
        with np.errstate(all="ignore"):
            values = np.asarray(system.residuals(start, system.size(length)))
    except (ValueError, IndexError, ZeroDivisionError):
        return False
    return len(start) == length and values.size > 0 and values.shape == (system.size(length), 2)
