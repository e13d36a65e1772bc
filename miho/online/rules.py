"""Sizes of a population of hypotheses, the places of its numbers, and the rules of its update."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from miho.online.outputs import System
from miho.online.prior import UNIFORM, place_of
from miho.online.state import Mixture
from miho.quantities import Array
from miho.validate import positive

if TYPE_CHECKING:
    from miho.online.settings import TrackerSettings

NUMBERS = ("row", "clock", "last_time", "since", "quiet_until", "turn", "odds", "alarm", "gain")
"""Counters of a population. `clock` is the time that has passed [s], `since` the last row that
counts as before a change, `gain` the information that the last row gave the best hypothesis."""


JUMP = 0.35
"""Share of its value by which a parameter may jump, unless `changes` says otherwise."""
NEAR_0, AROUND_0 = 3.0, 1000.0
"""Standard errors within which a parameter of either sign may be 0, and its largest size then."""
PLACE = {name: k for k, name in enumerate(NUMBERS)}


@dataclass(frozen=True)
class Layout:
    """Sizes of a population, and the place of each of its arrays in one memory of doubles.

    It has K hypotheses, d parameters, m outputs and p inputs. The first q inputs have noise, and
    the first n of these are states: their values at the end of the row are the first outputs.
    """

    K: int
    d: int
    m: int
    p: int
    q: int
    n: int = 0

    @cached_property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the arrays, in their order."""
        K, d, watched = self.K, self.d, self.q + self.m
        D = d + self.n
        return {
            "numbers": (len(NUMBERS),), "theta": (K, D), "P": (K, D, D), "share": (K, d),
            "weight": (K,), "drift": (K,), "calm": (K,), "born": (K,), "was": (K, d), "peak": (d,),
            "informed": (d,), "mean": (self.q,), "variance": (self.q,), "last": (watched,),
            "repeats": (watched,), "measured": (self.n,),
        }  # fmt: skip

    @cached_property
    def size(self) -> int:
        """Length of the memory."""
        return sum(math.prod(shape) for shape in self.shapes.values())

    @cached_property
    def estimate_size(self) -> int:
        """Length of an estimate: mean, covariance, and weights, means, deviations of hypotheses."""
        return self.d + self.d**2 + self.K * (1 + 2 * self.d)

    def estimate(self, numbers: Array) -> tuple[Array, Array, Mixture]:
        """Mean (d,), covariance (d, d) and distribution as views of an estimate."""
        K, d = self.K, self.d
        at = d + d * d
        weights, rest = numbers[at : at + K], numbers[at + K :].reshape(2, K, d)
        return numbers[:d], numbers[d:at].reshape(d, d), Mixture(weights, rest[0], rest[1])

    def views(self, memory: Array) -> dict[str, Array]:
        """The arrays as views of a memory."""
        arrays, at = {}, 0
        for name, shape in self.shapes.items():
            count = math.prod(shape)
            arrays[name] = memory[at : at + count].reshape(shape)
            at += count
        return arrays


@dataclass(frozen=True, eq=False)
class Rules:
    """Numbers by which a population is updated.

    Covariances and drifts are in the `unit` (d,) of each parameter: the size of a jump if it is
    `watched` (1, else 0), and otherwise its standard deviation before the first row. Bounds are
    `low` and `high` (d,). `sigma` (m,) are the standard deviations of the errors of the outputs,
    `noise` (q,) those of the first inputs. `long`, `middle` and `short` are the `drifts` of
    `TrackerSettings`, and all others its fields.
    """

    hazard: float
    onset: float
    outliers: float
    width: float
    threshold: float
    near: float
    long: float
    middle: float
    short: float
    use: float
    smooth: float
    hold: float
    repeats: float
    gap: float
    every: float
    cap: float
    step_error: float
    burst: float
    settle: float
    wrong: float
    unit: Array
    low: Array
    high: Array
    watched: Array
    sigma: Array
    noise: Array

    @cached_property
    def packed(self) -> Array:
        """All numbers in their order."""
        numbers = [np.atleast_1d(getattr(self, field.name)) for field in fields(self)]
        return np.concatenate(numbers).astype(float)


def rules_of(
    settings: TrackerSettings,
    system: System,
    theta: Array,
    covariance: Array,
    changes: Mapping[str, float] | None,
    noise: Mapping[str, float],
) -> Rules:
    """The rules of a tracker; units are jumps of watched parameters, and deviations of others."""
    if changes is None:
        changes = dict.fromkeys(system.reported.names, JUMP)
    deviations = np.sqrt(np.diag(covariance))
    unit, watched = deviations.copy(), np.zeros(theta.size)
    for name, share in changes.items():
        k = place_of("changes", name, system.reported.names)
        positive(f"changes.{name}", share)
        low, value = system.space.low[k], abs(theta[k])
        if value < (NEAR_0 if low < 0 else 1) * deviations[k]:  # a share of 0 is no size
            width = system.space.high[k] - low
            value = max(value, min(UNIFORM * width, AROUND_0 * deviations[k]))
        watched[k], unit[k] = 1.0, share * value or deviations[k]
    names = ("hazard", "onset", "outliers", "width", "threshold", "near", "use", "smooth", "hold",
             "gap", "every", "repeats", "cap", "step_error", "burst", "settle",
             "wrong")  # fmt: skip
    return Rules(
        **{name: float(getattr(settings, name)) for name in names},
        **dict(zip(("long", "middle", "short"), settings.drifts, strict=True)),
        unit=unit,
        low=system.space.low,
        high=system.space.high,
        watched=watched,
        sigma=system.sigma,
        noise=np.array([*noise.values()], dtype=float),
    )


def peak_of(system: System, rules: Rules, theta: Array) -> Array:
    """The largest information (d,) of a row of the offline data on each parameter."""
    peak = np.zeros(theta.size)
    for output in system.outputs:
        own = [system.names.index(name) for name in output.parameters]
        slopes = np.abs(output.model.jacobian(theta[own], *output.examples()))
        largest = np.where(np.isfinite(slopes), slopes, 0.0).max(axis=0) * rules.unit[own]
        peak[own] = np.hypot(peak[own], largest / output.sigma)
    return peak
