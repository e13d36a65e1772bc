"""Parameters and their bounds, and where searches start within them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
import scipy  # loads its packages at their first use; importing them here takes a second
from numpy.typing import NDArray

from miho.optim.seeds import Part, stream
from miho.quantities import Array
from miho.validate import one_of

if TYPE_CHECKING:
    from miho.radial_map import RadialMap

SCALES = ("linear", "log")
SAMPLINGS = ("normal", "uniform_plus_noise", "uniform")
COMMON = 30
"""Number of common initial configurations that are drawn once."""
SEEDED = ("seed", "free", "_common")
"""Attributes of a space that depend on its seed."""
LARGEST_BATCH = 10_000_000
"""Largest number of configurations that fit into the memory of a machine."""


@dataclass(frozen=True)
class Parameter:
    """One parameter: its unit, range and scale, and how searches draw and mutate it.

    Parameters
    ----------
    name : str
        Name of the parameter.
    unit : str
        Unit of its value.
    low, high : float
        Bounds, in the unit; finite unless the parameter is fixed or tied. With low = high the
        parameter is fixed.
    scale : {"linear", "log"}, optional
        Scale on which searches move. On the log scale `mean` has the unit of the parameter, and
        `std`, `sigma_max` and `sigma_min` are in natural-log units (0.1 is about 10 %).
    mean, std : float, optional
        Mean and standard deviation of the initial distribution, truncated to the range (Alg. 1,
        line 4); by default the middle and a quarter of the range. They only determine where
        searches start.
    sigma_max, sigma_min : float, optional
        Largest and smallest standard deviation of a mutation (Eq. 2); by default a tenth of the
        range, and 0.
    fixed : float, optional
        Value of a parameter that is not searched for.
    tied : str, optional
        Expression of other parameters that gives the value, for example "1 - a - b". A range is
        then a limit: no configuration beyond it has a value.
    prior : tuple of float, optional
        Prior knowledge besides the data: mean and standard deviation of a normal distribution, or
        on the log scale its median and standard deviation in natural-log units. The bounds truncate
        it. Its mean may be up to 3 standard deviations outside the bounds.
    stands_for : Parameter, optional
        The parameter that results report instead, which is tied to this one and to others.

    Raises
    ------
    ValueError
        If the settings contradict each other.

    Examples
    --------
    >>> import miho
    >>> rate = miho.Parameter("k", "1/s", low=1e-3, high=1e3, scale="log")
    >>> rate.free
    True
    """

    name: str
    unit: str
    low: float = -math.inf
    high: float = math.inf
    scale: str = "linear"
    mean: float | None = None
    std: float | None = None
    sigma_max: float | None = None
    sigma_min: float = 0.0
    fixed: float | None = None
    tied: str | None = None
    prior: tuple[float, float] | None = None
    stands_for: Parameter | None = None

    def __post_init__(self) -> None:
        label = f"parameter {self.name!r}"
        if not isinstance(self.unit, str):
            raise ValueError(f"{label}: unit is {self.unit!r}; expected a text such as 'V' or '-'")
        if self.free and math.isfinite(self.low) and self.low == self.high:
            object.__setattr__(self, "fixed", self.low)
        one_of(f"{label}: scale", self.scale, SCALES)
        if self.prior is not None:
            from miho.optim.refused_arguments import checked_prior

            object.__setattr__(self, "prior", checked_prior(self, label))
        if not self.free:
            self._check_not_free(label)
            return
        if not (self.low < self.high and math.isfinite(self.high - self.low)):
            raise ValueError(
                f"{label}: low is {self.low!r} and high is {self.high!r}; "
                "expected finite bounds with low < high, or fixed or tied, or a start in miho.fit"
            )
        if self.scale == "log" and self.low <= 0:
            raise ValueError(f"{label}: low is {self.low!r}; expected above 0 on the log scale")
        if self.mean is not None and not self.low <= self.mean <= self.high:
            raise ValueError(f"{label}: mean is {self.mean!r}; expected within the range")
        if self.std is not None and not 0 < self.std < math.inf:
            raise ValueError(f"{label}: std is {self.std!r}; expected above 0")
        if not 0 <= self.sigma_min <= self.largest_sigma < math.inf:
            raise ValueError(
                f"{label}: sigma_min is {self.sigma_min!r} and sigma_max is "
                f"{self.largest_sigma!r}; expected 0 <= sigma_min <= sigma_max, finite"
            )

    @property
    def free(self) -> bool:
        """Whether the parameter is searched for."""
        return self.fixed is None and self.tied is None

    def _check_not_free(self, label: str) -> None:
        if self.fixed is not None and self.tied is not None:
            raise ValueError(
                f"{label}: is fixed to {self.fixed!r} and tied to {self.tied!r}; choose one"
            )
        if self.fixed is not None and not math.isfinite(self.fixed):
            raise ValueError(f"{label}: fixed is {self.fixed!r}; expected a finite number")
        if not self.low <= (self.low if self.fixed is None else self.fixed) <= self.high:
            from miho.optim.refused_arguments import check_ends

            check_ends(self, label)

    @property
    def largest_sigma(self) -> float:
        """sigma_max, by default a tenth of the range."""
        if self.sigma_max is not None:
            return self.sigma_max
        log = self.scale == "log"
        return (math.log(self.high / self.low) if log else self.high - self.low) / 10


@dataclass(frozen=True)
class Space:
    """Named parameters in a fixed order; theta[i] is the value of parameters[i], in its unit.

    Searches move in search coordinates: the natural logarithm of a parameter on the log scale, the
    parameter itself otherwise (`encode`, `decode`).

    Parameters
    ----------
    parameters : sequence of Parameter
        The parameters; their names must differ.
    seed : tuple, optional
        Seed of the common initial configurations. `minimize` sets it from problem and repetition,
        so that all methods start from the same configurations (`initial`).
    radial : RadialMap, optional
        Map from shares to values of parameters under constraints.

    Raises
    ------
    ValueError
        If there is no parameter, or if two have the same name.

    Examples
    --------
    >>> import numpy as np
    >>> import miho
    >>> space = miho.Space((
    ...     miho.Parameter("a", "V", 0, 5),
    ...     miho.Parameter("k", "1/s", 1e-3, 1e3, scale="log"),
    ... ))
    >>> space.names
    ('a', 'k')
    >>> space.decode(np.array([2.0, 0.0]))
    array([2., 1.])
    """

    parameters: tuple[Parameter, ...]
    seed: tuple[Part, ...] = ()
    radial: RadialMap | None = None

    def __post_init__(self) -> None:
        parameters = tuple(self.parameters) if isinstance(self.parameters, Iterable) else ()
        if not parameters or not all(isinstance(parameter, Parameter) for parameter in parameters):
            example = "at least one parameter, for example miho.Parameter('a', 'V', 0, 5)"
            raise ValueError(f"space: expected {example}; got {self.parameters}")
        object.__setattr__(self, "parameters", parameters)
        if len(set(self.names)) != len(self.names):
            raise ValueError(f"parameter names must differ; got {', '.join(self.names)}")

    def __len__(self) -> int:
        return len(self.parameters)

    @cached_property
    def free(self) -> Space:
        """Space of the parameters that are searched for."""
        if all(parameter.free for parameter in self.parameters):
            return self
        free = tuple(parameter for parameter in self.parameters if parameter.free)
        if not free:
            raise ValueError(
                f"every parameter of the space is fixed or tied ({', '.join(self.names)}); "
                "leave one free"
            )
        return replace(self, parameters=free)

    def in_order(self, names: Iterable[str]) -> Space:
        """The same parameters: first those with these names, in their order, then the others."""
        places = {name: place for place, name in enumerate(names)}
        ordered = sorted(self.parameters, key=lambda p: places.get(p.name, len(places)))
        return replace(self, parameters=tuple(ordered))

    @property
    def has_priors(self) -> bool:
        """Whether any parameter has a prior."""
        return any(parameter.prior is not None for parameter in self.parameters)

    @property
    def without_priors(self) -> Space:
        """The same space without priors."""
        return replace(self, parameters=tuple(replace(p, prior=None) for p in self.parameters))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of theta."""
        return tuple(parameter.name for parameter in self.parameters)

    @cached_property
    def low(self) -> Array:
        """Lower bounds in units, (d,)."""
        return np.array([p.low for p in self.parameters], dtype=float)

    @cached_property
    def high(self) -> Array:
        """Upper bounds in units, (d,)."""
        return np.array([p.high for p in self.parameters], dtype=float)

    @cached_property
    def _log(self) -> NDArray[np.bool_]:
        return np.array([p.scale == "log" for p in self.parameters])

    @cached_property
    def _any_log(self) -> bool:
        return bool(self._log.any())

    def encode(self, thetas: Array) -> Array:
        """Convert units to search coordinates, (..., d)."""
        if not self._any_log:
            return thetas
        coordinates = thetas.copy()
        coordinates[..., self._log] = np.log(thetas[..., self._log])
        return coordinates

    def decode(self, coordinates: Array) -> Array:
        """Convert search coordinates to units, (..., d)."""
        if not self._any_log:
            return coordinates
        thetas = coordinates.copy()
        thetas[..., self._log] = np.exp(coordinates[..., self._log])
        return thetas

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds in search coordinates, (d,) each."""
        return self.encode(self.low), self.encode(self.high)

    @cached_property
    def scales(self) -> dict[int, tuple[Array, ...]]:
        """Cache of `miho.optim.brackets.by_scale`, by decades."""
        return {}

    @cached_property
    def sigma(self) -> tuple[Array, Array]:
        """Largest and smallest sigma of mutations in search coordinates, (d,) each (Eq. 2)."""
        return (
            np.array([p.largest_sigma for p in self.parameters]),
            np.array([p.sigma_min for p in self.parameters]),
        )

    def clip(self, thetas: Array) -> Array:
        """Nearest points within the bounds, in units, (..., d)."""
        return np.minimum(np.maximum(thetas, self.low), self.high)

    @cached_property
    def widened(self) -> tuple[Array, Array]:
        """Bounds in units, (d,) each, widened by the rounding of the log scale."""
        slack = 4 * np.finfo(float).eps * np.maximum(np.abs(self.low), np.abs(self.high))
        return self.low - slack, self.high + slack

    def contains(self, thetas: Array) -> NDArray[np.bool_]:
        """Whether each row is within the bounds, up to the rounding of the log scale, (n,)."""
        low, high = self.widened
        inside = (thetas >= low) & (thetas <= high)
        return np.asarray(inside.all(axis=-1))

    def sample(self, n: int, rng: np.random.Generator, sampling: str = "normal") -> Array:
        """Draw configurations from the initial distribution.

        Parameters
        ----------
        n : int
            Number of configurations.
        rng : numpy.random.Generator
            Source of randomness. From the same state, a longer draw begins with the rows of a
            shorter one.
        sampling : {"normal", "uniform_plus_noise", "uniform"}, optional
            "normal" is the initial distribution of the paper, truncated to the bounds.
            "uniform_plus_noise" adds Gaussian noise of sigma_max to a uniform draw, as the authors'
            public code does, and may leave the bounds. "uniform" fills the bounds.

        Returns
        -------
        ndarray of shape (n, d)
            Configurations in search coordinates.
        """
        one_of("sampling", sampling, SAMPLINGS)
        low, high = self.bounds
        d = len(self)
        if sampling == "uniform":
            return low + (high - low) * rng.random((n, d))
        if sampling == "uniform_plus_noise":
            draws = rng.random((n, 2 * d))
            noise = scipy.special.ndtri(np.maximum(draws[:, d:], np.finfo(float).tiny))
            return np.asarray(low + (high - low) * draws[:, :d] + self.sigma[0] * noise)
        return self.quantiles(rng.random((n, d)))

    def quantiles(self, u: Array) -> Array:
        """Quantiles u (n, d) of the initial distribution, in search coordinates."""
        low, high = self.bounds
        mean, std, below, inside = self._normal
        draws = mean + std * scipy.special.ndtri(below + inside * u)
        return np.minimum(np.maximum(draws, low), high)

    @cached_property
    def _normal(self) -> tuple[Array, Array, Array, Array]:
        """Parameters of the initial distribution in search coordinates, (d,) each.

        They are mean, standard deviation, and the probabilities below and inside the range.
        """
        low, high = self.bounds
        middle = self.decode((low + high) / 2)
        mean = [
            m if p.mean is None else p.mean for m, p in zip(middle, self.parameters, strict=True)
        ]
        quarter = (high - low) / 4
        std = [q if p.std is None else p.std for q, p in zip(quarter, self.parameters, strict=True)]
        center, deviation = self.encode(np.array(mean)), np.array(std)
        below, above = (scipy.special.ndtr((end - center) / deviation) for end in (low, high))
        return center, deviation, below, above - below

    def initial(self, n: int, sampling: str = "normal") -> Array:
        """First n common initial configurations, in search coordinates, (n, d)."""
        if sampling == "normal" and n <= COMMON:
            return self._common[:n].copy()
        return self.sample(n, stream("initial", *self.seed), sampling)

    @cached_property
    def _common(self) -> Array:
        """First common initial configurations."""
        return self.quantiles(_common_shares(len(self), *self.seed))

    def seeded(self, *seed: Part) -> Space:
        """This space with other common initial configurations."""
        space = object.__new__(Space)  # all other cached properties stay valid
        vars(space).update({key: value for key, value in vars(self).items() if key not in SEEDED})
        vars(space)["seed"] = seed
        return space


@lru_cache(maxsize=256, typed=True)
def _common_shares(d: int, *seed: Part) -> Array:
    """Random numbers (COMMON, d) of the common initial configurations with this seed."""
    return stream("initial", *seed).random((COMMON, d))
