"""The state after an update, and the alarm that a change raises."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from miho.core import machine
from miho.quantities import Array
from miho.validate import between_0_and_1

SIGNIFICANT = 2.0
"""Standard errors from which a change of one parameter is significant."""
SUSPECT = 0.5
"""Share of the most significant change from which another parameter is a suspect."""
NEGLIGIBLE = 1e-6
"""Share of a hypothesis below which it does not count in an interval."""
FAR, BISECTIONS, SMALLEST = 40.0, 36, 1e-300
"""Deviations that hold all of a distribution, halvings of an interval, smallest deviation."""


class Mixture(NamedTuple):
    """A mixture of K normal distributions of d parameters.

    Parameters
    ----------
    weights : ndarray of shape (K,)
        Weights, whose sum is 1.
    means, deviations : ndarray of shape (K, d)
        Means and standard deviations.
    """

    weights: Array
    means: Array
    deviations: Array


@dataclass(frozen=True)
class Alarm:
    """A detected change of parameters.

    Parameters
    ----------
    time : float
        Time of the row that raised the alarm [s].
    parameter : str or None
        The parameter whose change is most significant; None if no single one is significant.
    before, after : float
        Its values before the change and at the alarm, in its unit.
    standard_error : float
        Standard error of their difference.
    others : tuple of Alarm, optional
        Further parameters with a significant change at the same time.
    suspects : tuple of str, optional
        Parameters of which at least one has changed, if no single change is significant.

    Examples
    --------
    >>> str(Alarm(12.4, "D", before=1000.0, after=690.0, standard_error=40.0))
    'D fell by 31 ± 4 % at 12.4 s'
    """

    time: float
    parameter: str | None
    before: float
    after: float
    standard_error: float
    others: tuple[Alarm, ...] = ()
    suspects: tuple[str, ...] = ()

    def __str__(self) -> str:
        each = " and ".join(alarm.size for alarm in (self, *self.others))
        return f"{each} at {self.time:.1f} s"

    def with_names(self, name: Callable[[str], str]) -> Alarm:
        """Return the alarm with other names of the parameters.

        Parameters
        ----------
        name : callable
            Returns the new name of a parameter.

        Returns
        -------
        Alarm
            The alarm in these names.

        Examples
        --------
        >>> alarm = Alarm(12.4, "D", before=1000.0, after=690.0, standard_error=40.0)
        >>> str(alarm.with_names({"D": "front grip"}.get))
        'front grip fell by 31 ± 4 % at 12.4 s'
        """
        return replace(
            self,
            parameter=None if self.parameter is None else name(self.parameter),
            others=tuple(alarm.with_names(name) for alarm in self.others),
            suspects=tuple(name(suspect) for suspect in self.suspects),
        )

    @property
    def size(self) -> str:
        """The change in words, without its time."""
        if self.parameter is None:
            *most, last = self.suspects
            return f"{', '.join(most)} or {last} changed" if most else f"{last} changed"
        verb = "fell" if self.after < self.before else "rose"
        change = abs(self.after - self.before)
        if abs(self.before) <= self.standard_error:  # perhaps 0
            return f"{self.parameter} {verb} by {change:.2g} ± {self.standard_error:.1g}"
        share = 100 / abs(self.before)
        error = share * self.standard_error
        return f"{self.parameter} {verb} by {share * change:.0f} ± {error:.0f} %"


class Change(NamedTuple):
    """Estimates (d,) before and after a change, and their standard errors."""

    before: Array
    after: Array
    before_errors: Array
    after_errors: Array


def alarm_of(change: Change, time: float, names: Sequence[str], watched: Array) -> Alarm:
    """Return the alarm at a time [s]: the `watched` parameters, the most significant change first.

    Not watched are parameters with a 0 in `watched` (d,).
    """
    errors = np.hypot(change.before_errors, change.after_errors)
    ratios = np.abs(change.after - change.before) / np.maximum(errors, SMALLEST)
    order = [int(k) for k in np.argsort(-ratios) if watched[k]]
    named = [
        Alarm(time, names[k], float(change.before[k]), float(change.after[k]), float(errors[k]))
        for k in order
        if ratios[k] >= SIGNIFICANT
    ]
    if named:
        return replace(named[0], others=tuple(named[1:]))
    likely = SUSPECT * ratios[order[0]]
    suspects = tuple(names[k] for k in sorted(order) if ratios[k] >= likely)
    return Alarm(time, None, math.nan, math.nan, math.nan, (), suspects)


@dataclass(frozen=True, eq=False, repr=False)
class TrackerState:
    """The parameters after an update.

    Parameters
    ----------
    time : float
        Time of the last row [s].
    names : tuple of str
        Names of the parameters.
    theta : ndarray of shape (d,)
        Estimates.
    covariance : ndarray of shape (d, d)
        Covariance of the estimates; NaN for a method without one.
    identifiable : bool ndarray of shape (d,)
        Whether recent rows inform each parameter.
    alarm : Alarm or None
        The change that this update has detected.
    odds : float
        Logarithm of the odds that a parameter has changed since the last alarm; NaN for a method
        without it.
    rows : int
        Number of all rows so far.
    seconds : float
        Duration of the update [s].
    mixture : Mixture or None
        The distribution of the parameters; None for a normal one.
    bounds : tuple of ndarray, optional
        Lower and upper bounds (d,) each, which limit the intervals.
    """

    time: float
    names: tuple[str, ...]
    theta: Array
    covariance: Array
    identifiable: NDArray[np.bool_]
    alarm: Alarm | None = None
    odds: float = math.nan
    rows: int = 0
    seconds: float = 0.0
    mixture: Mixture | None = None
    bounds: tuple[Array, Array] | None = None

    def __repr__(self) -> str:
        each = zip(self.names, self.theta, self.deviations, strict=True)
        values = ", ".join(f"{name} = {value:.4g} ± {error:.2g}" for name, value, error in each)
        return f"TrackerState({self.time:.2f} s: {values}; alarm: {self.alarm})"

    @cached_property
    def values(self) -> Mapping[str, float]:
        """Estimates by name."""
        return dict(zip(self.names, self.theta.tolist(), strict=True))

    @cached_property
    def deviations(self) -> Array:
        """Standard deviations of the estimates (d,)."""
        return np.sqrt(np.diag(self.covariance))

    def intervals(self, level: float = 0.95) -> Array:
        """Return the intervals of the parameters.

        Parameters
        ----------
        level : float, optional
            Probability that an interval holds its parameter.

        Returns
        -------
        ndarray of shape (d, 2)
            Lower and upper ends, within the bounds.

        Raises
        ------
        ValueError
            If `level` is not between 0 and 1.
        """
        between_0_and_1("level", level)
        if self.mixture is None:
            reach = float(scipy.special.ndtri((1 + level) / 2)) * self.deviations
        else:
            reach = mixture_reach(self.theta, self.mixture, level)
        ends = np.stack([self.theta - reach, self.theta + reach], axis=1)
        return ends if self.bounds is None else np.clip(ends.T, *self.bounds).T


def mixture_reach(centre: Array, mixture: Mixture, level: float) -> Array:
    """Return the half widths (d,) of intervals about a centre that have a probability `level`."""
    if machine() is not None:
        out = np.empty(centre.size)
        machine().mixture_reach(*mixture, centre, level, out)
        return out
    return reach_by_numpy(centre, mixture, level)


def reach_by_numpy(centre: Array, mixture: Mixture, level: float) -> Array:
    """Half widths (d,) by bisection, as in the machine, which knows probabilities to 1e-7."""
    counted = mixture.weights > NEGLIGIBLE
    weights = mixture.weights[counted, None] / mixture.weights[counted].sum()
    away = mixture.means[counted] - centre
    deviations = np.maximum(mixture.deviations[counted], SMALLEST)
    low, high = np.zeros(centre.size), np.max(np.abs(away) + FAR * deviations, axis=0)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        inside = scipy.special.ndtr((middle - away) / deviations)
        inside -= scipy.special.ndtr((-middle - away) / deviations)
        enough = np.sum(weights * inside, axis=0) >= level
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    return np.asarray((low + high) / 2)
