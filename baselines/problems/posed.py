"""Published problems with the box of each parameter, by rule.

The name of a published fit ends in the rule of its box: `nist_misra1a_log`. `mw_...` are the 53
problems of Moré and Wild (SIAM J. Optim. 20, 2009), `cr_...` systems of Cartis and Roberts (Math.
Prog. Comp. 11, 2019) that exist for eight to twelve variables. A system is used if its formula
gives their printed sum of squares at the starting point, or if it is in an older publication
(`baselines.problems.cartis_roberts`). These names end in the number of variables, and in `far` if
the starting point is ten times as far from zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from baselines.problems.published_fits import PublishedFit, published_fit, zero_residuals
from baselines.problems.published_model import PublishedModel
from baselines.problems.residual_systems import ResidualSystem
from miho.data.dataset import Dataset
from miho.quantities import Array

Range = tuple[float, float, str]
"""Both ends of a parameter and its scale, `log` or `linear`."""

AROUND = 100.0
"""Factor from a certified value to either end of its logarithmic box."""
SPREADS = 10.0
LEAST_SPREAD = 0.1
"""Smallest spread relative to the published value, if the starting values are close to it."""
DIGITS = 1e-6
"""Relative error of a parameter with six correct digits."""
AROUND_START = 10.0
"""Half the width of a box in multiples of max(1, |x|) at the starting value x. With 10, all
published optima but one are inside: x9 of Watson's function of twelve variables is at a bound, and
inside for the far starting point."""
FAR = 10.0
"""Factor of Moré and Wild between the first and the second starting point."""
ARRIVED = 1e-6
"""An error below this share of the error at the starting point counts as zero. The smallest other
optimum has 2.5e-6 of it (Watson's function of twelve variables); rounding gives 1e-16."""
FITS: Mapping[str, tuple[str, tuple[float, ...]]] = {
    "bard": ("bard", (1.0, 1.0, 1.0)),
    "kowalik_osborne": ("mgh09", (0.25, 0.39, 0.415, 0.39)),
    "meyer": ("mgh10", (0.02, 4000.0, 250.0)),
    "jennrich_sampson": ("jennrich", (0.3, 0.4)),
    # The third is -1 in More, Garbow and Hillstrom.
    "osborne_1": ("mgh17", (0.5, 1.5, 1.0, 0.01, 0.02)),
    "osborne_2": ("osborne2", (1.3, 0.65, 0.65, 0.7, 0.6, 3.0, 5.0, 7.0, 2.0, 4.5, 5.5)),
}
"""Functions of Moré and Wild that are also published fits here, and their starting points."""
TITLES = {
    "mw": "one of the 53 problems of More and Wild (2009)",
    "cr": "a system of CUTEst in the table of Cartis and Roberts (2019)",
}


def around(fit: PublishedFit, k: int) -> Range:
    """Two powers of ten on either side of a positive value; ten times a negative one either way."""
    value = fit.optimum[k]
    if value > 0:
        return value / AROUND, value * AROUND, "log"
    return -math.sqrt(AROUND) * -value, math.sqrt(AROUND) * -value, "linear"


def decades(fit: PublishedFit, k: int) -> Range:
    """Whole powers of ten, at least one beyond the value, which a negative one has either way."""
    value = fit.optimum[k]
    exponent = math.floor(math.log10(abs(value)))
    if value > 0:
        return 10.0 ** (exponent - 1), 10.0 ** (exponent + 2), "log"
    return -(10.0 ** (exponent + 2)), 10.0 ** (exponent + 2), "linear"


def starts(fit: PublishedFit, k: int) -> Range:
    """Ten times as wide as the spread of the published starts and the value, around its middle."""
    values = [fit.optimum[k], *(start[k] for start in fit.starts)]
    low, high = min(values), max(values)
    half = SPREADS / 2 * max(high - low, LEAST_SPREAD * abs(fit.optimum[k]))
    return (low + high) / 2 - half, (low + high) / 2 + half, "linear"


RULES: Mapping[str, tuple[Callable[[PublishedFit, int], Range], str]] = {
    "log": (
        around,
        "a hundredth of a positive value to a hundred times it, logarithmic; ten times a negative "
        "one either way, linear",
    ),
    "decades": (
        decades,
        "powers of ten, at least one beyond a positive value on both sides, logarithmic; either "
        "way for a negative one, linear",
    ),
    "starts": (
        starts,
        "linear, ten times as wide as the spread of the published starts and the optimum, around "
        "the middle of these",
    ),
}
"""Rules for a range, with their descriptions."""


@dataclass(frozen=True, eq=False)
class PosedProblem:
    """A published problem with the range of each parameter.

    `about` describes it, and problems of one `family` share the formula. A problem of Moré and Wild
    or of Cartis and Roberts has the published starting point `start`, and each of its variables has
    a range around it, from x - 10 s to x + 10 s with s = max(1, |x|), cut if the publication keeps
    a variable positive. An error below `resolution` counts as zero.
    """

    name: str
    about: str
    family: str
    model: PublishedModel | ResidualSystem
    dataset: Dataset
    ranges: Mapping[str, Range]
    resolution: float
    start: Array | None = None

    def residuals(self, theta: Array) -> Array:
        """Residuals (m,) at one configuration (n,)."""
        return _residuals(self.model, self.dataset, theta)


def posed_problem(name: str) -> PosedProblem:
    """Return the published problem and box of a name in `conf/problem/published.csv`."""
    collection, _, rest = name.partition("_")
    if collection in TITLES:
        return _around_its_start(name, collection, rest)
    function, _, rule = rest.rpartition("_")
    fit = published_fit(function)
    range_of, meaning = RULES[rule]
    model = PublishedModel(fit.model)
    size = f"{len(fit.optimum)} parameters, {len(fit.dataset)} rows"
    return PosedProblem(
        name,
        f"{fit.title}.\n{size}. Box: {meaning}.",
        fit.model,
        model,
        fit.dataset,
        {parameter: _rounded(range_of(fit, k)) for k, parameter in enumerate(model.parameters)},
        _six_digits(fit, model),
    )


def _around_its_start(name: str, collection: str, rest: str) -> PosedProblem:
    """Return a problem of Moré and Wild or of Cartis and Roberts."""
    function, _, length = rest.removesuffix("_far").rpartition("_")
    factor = FAR if rest.endswith("_far") else 1.0
    model: PublishedModel | ResidualSystem
    least: Array | float = -np.inf
    if function in FITS:
        fit = published_fit(FITS[function][0])
        model, dataset, near = PublishedModel(fit.model), fit.dataset, np.array(FITS[function][1])
    else:
        model = ResidualSystem(function, int(length))
        dataset, near = zero_residuals(model.size), model.start
        if model.published.low is not None:
            least = np.asarray(model.published.low(model.length))
    start = np.asarray(factor * near)
    half = AROUND_START * np.maximum(1.0, np.abs(start))
    low, high = np.maximum(start - half, least), start + half
    place = "published start" if factor == 1 else "published start times ten"
    return PosedProblem(
        name,
        f"{function}, {TITLES[collection]}: {length} variables, {len(dataset)} residuals. Box: ten "
        f"times max(1, |x|) around the {place} x of each variable, either way.",
        function,
        model,
        dataset,
        {
            parameter: _rounded((float(a), float(b), "linear"))
            for parameter, a, b in zip(model.parameters, low, high, strict=True)
        },
        _one_digit(ARRIVED * math.sqrt(np.mean(_residuals(model, dataset, near) ** 2))),
        start,
    )


def _residuals(model: PublishedModel | ResidualSystem, dataset: Dataset, theta: Array) -> Array:
    inputs = (dataset[column] for column in model.inputs)
    return np.asarray(model.predict(theta[None], *inputs)[0] - dataset["y"])


def _six_digits(fit: PublishedFit, model: PublishedModel) -> float:
    """Error at which the least certain parameter still has six digits, rounded down to one digit.

    At an error s of exact data, parameter k is off by at most s ((J'J / N)^-1_kk)^(1/2).
    """
    theta = np.array(fit.optimum)
    J = model.jacobian(theta, *(fit.dataset[name] for name in model.inputs))
    _, sizes, directions = np.linalg.svd(J * theta / math.sqrt(len(J)), full_matrices=False)
    worst = float(np.sqrt(((directions.T / sizes) ** 2).sum(axis=1)).max())
    return _one_digit(DIGITS / worst)


def _one_digit(value: float) -> float:
    """Round a positive value down to one digit."""
    unit = 10.0 ** math.floor(math.log10(value))
    return float(f"{math.floor(value / unit) * unit:.0e}")


def _rounded(ends: Range) -> Range:
    """Round both ends to fourteen digits, so that rounding errors do not show."""
    low, high, scale = ends
    return float(f"{low:.14g}"), float(f"{high:.14g}"), scale
