"""Quantities derived from a fitted curve: cornering stiffness, peak value and peak position."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

import miho.models as models
from miho.data.dataset import Dataset
from miho.identification.uncertainty import Linearised
from miho.models.joint import PART, parts_of
from miho.models.model import Model
from miho.models.tied import Tied
from miho.quantities import Array

REACH = 1.5
"""The search for peaks extends to this multiple of the largest input in the data."""
GRID = 601
STEP = 1e-6
"""Smallest step of differences, as a fraction of a parameter."""
UNCHANGED = 1e-9
"""A relative change of a quantity up to this is rounding: a quantity that is proportional to a
parameter changes by at least STEP."""
SAME = 0.1
"""Loads count as one load if they are within this fraction of each other."""

SIGNS = {
    "cornering stiffness": 1, "peak friction": 1, "mean peak force": 1,
    "peak force, alpha > 0": -1, "peak force, alpha < 0": 1,
}  # fmt: skip
"""The signs of these quantities for every tire, in ISO-W."""


@dataclass(frozen=True)
class Derived:
    """A quantity computed from parameter rows (n, d).

    Parameters
    ----------
    name, unit : str
        Name and unit of the quantity.
    evaluate : callable
        Gives values (n,) at parameter rows (n, d); NaN if there is no value.
    tied : str
        The name of the tied or fixed parameter, if the quantity is one.
    sign : int
        The sign of the quantity for every tire in ISO-W; 0 if there is no such sign.
    """

    name: str
    unit: str
    evaluate: Callable[[Array], Array]
    tied: str = ""
    sign: int = 0


def derived(model: Model, dataset: Dataset) -> tuple[Derived, ...]:
    """The derived quantities of a model.

    A tire (N over alpha as the first input) has stiffness, peaks and friction; a torque curve (Nm
    over omega) has its peak. Further inputs of the model are fixed at their median in the data.
    Other models have the quantities that they declare, and joint models the quantities of each
    part. Fixed and tied parameters come first.
    """
    if isinstance(model, Tied):
        return _tied(model, dataset)
    if parts_of(model):
        return _of_parts(model, dataset)
    first = next(iter(model.inputs))
    if first == "alpha" and model.output == "N":
        return _tire(model, dataset)
    if first == "omega" and model.output == "Nm":
        return _torque(model, dataset)
    declared = model.derived.items()
    return _signed(Derived(name, unit, values) for name, (unit, values) in declared)


def _tied(model: Tied, dataset: Dataset) -> tuple[Derived, ...]:
    """The fixed and tied parameters, and the quantities of the whole model."""
    ties = model.ties
    units = {**model.model.parameters, **ties.quantities}

    def parameter(k: int) -> Callable[[Array], Array]:
        return lambda thetas: ties.values(thetas)[:, k]

    def of_whole(quantity: Derived) -> Derived:
        return replace(quantity, evaluate=lambda thetas: quantity.evaluate(ties.whole(thetas)))

    parameters = []
    for k, name in enumerate(ties.names):
        tie = ties.ties.get(name)
        if tie is not None:
            label = f"{name} = {tie}" if isinstance(tie, str) else f"{name}, fixed"
            parameters.append(Derived(label, units[name], parameter(k), name))
    return (*parameters, *(of_whole(quantity) for quantity in derived(model.model, dataset)))


def _of_parts(model: Model, dataset: Dataset) -> tuple[Derived, ...]:
    """The quantities of each part, from its data and parameters."""
    names, quantities = list(model.parameters), []
    for k, part in enumerate(parts_of(model)):
        places = [names.index(name) for name in part.parameters]
        for quantity in derived(part.model, dataset.select(dataset[PART] == k)):
            name, evaluate = f"{quantity.name}, {part.name}", partial(_chosen, quantity, places)
            quantities.append(replace(quantity, name=name, evaluate=evaluate))
    return tuple(quantities)


def _chosen(quantity: Derived, places: list[int], thetas: Array) -> Array:
    """A quantity that depends on the parameters at some places."""
    return quantity.evaluate(thetas[:, places])


def _signed(quantities: Iterable[Derived]) -> tuple[Derived, ...]:
    """The quantities of a tire with their signs, by name."""
    return tuple(
        replace(q, sign=next((sign for name, sign in SIGNS.items() if name in q.name), 0))
        for q in quantities
    )


def _is_tire(model: Model) -> bool:
    """Whether it is a tire model of MIHO, weighted or not, which is in ISO-W."""
    while isinstance(inner := getattr(model, "model", None), Model):
        model = inner
    kinds = (models.Pacejka, models.PacejkaCurvature, models.PacejkaLandmarks)
    return isinstance(model, (*kinds, models.TireFormula, models.LateralMagicFormula))


def delta_method(quantity: Derived, at: Linearised) -> tuple[float, float]:
    """Value and standard error of a derived quantity, to first order in the parameters.

    The error is NaN if the quantity depends only on parameters at a bound.
    """
    value = float(quantity.evaluate(at.theta[None])[0])
    return value, float(at.spread(_slopes(quantity, at)[None])[0])


def interval_of(quantity: Derived, at: Linearised, level: float) -> Array:
    """The ends (1, 2) of the linearised interval of a derived quantity."""
    value, error = delta_method(quantity, at)
    reach = float(at.quantiles(gradient(quantity, at)[None], level)[0]) * error
    return np.array([[value - reach, value + reach]])


def is_held(quantity: Derived, at: Linearised) -> bool:
    """Whether a derived quantity depends only on parameters at a bound."""
    slopes = _slopes(quantity, at)
    return bool(slopes[at.at_bound].any() and not slopes[~at.at_bound].any())


def gradient(quantity: Derived, at: Linearised) -> Array:
    """Derivatives (d,) of a derived quantity, 0 for parameters at a bound."""
    return np.where(at.at_bound, 0.0, _slopes(quantity, at))


def _slopes(quantity: Derived, at: Linearised) -> Array:
    """Derivatives (d,) of a derived quantity by differences, 0 for changes up to rounding.

    The difference is one-sided if the quantity has a value on one side only, as beyond a bound.
    """
    step = np.maximum(1e-2 * np.sqrt(np.diag(at.covariance)), STEP * np.abs(at.theta))
    step[step == 0] = STEP
    value = quantity.evaluate(at.theta[None])
    high, low = (quantity.evaluate(at.theta + sign * np.diag(step)) for sign in (1, -1))
    above, below = np.isfinite(high), np.isfinite(low)
    high, low = np.where(below & ~above, value, high), np.where(above & ~below, value, low)
    width = np.where(above == below, 2.0, 1.0) * step
    rounding = UNCHANGED * np.maximum(np.abs(high), np.abs(low))
    return np.asarray(np.where(np.abs(high - low) <= rounding, 0.0, (high - low) / width))


def _at(model: Model, dataset: Dataset, values: Array) -> tuple[Array, ...]:
    """Input columns with these values of the first input and the medians of the others."""
    held_inputs = list(model.inputs)[1:]
    return (values, *(np.full(values.size, np.median(dataset[name])) for name in held_inputs))


def _tire(model: Model, dataset: Dataset) -> tuple[Derived, ...]:
    """Cornering stiffness, both peaks, and the friction there if the data have the load."""
    reach = REACH * float(np.abs(dataset["alpha"]).max())
    grids = np.linspace(0, reach, GRID), np.linspace(-reach, 0, GRID)  # alpha > 0, alpha < 0
    h = 1e-4 * reach  # step of the derivative at zero slip

    def stiffness(thetas: Array) -> Array:
        force = model.predict(thetas, *_at(model, dataset, np.array([-h, h])))
        return np.asarray((force[:, 0] - force[:, 1]) / (2 * h))

    def peak(alpha: Array, sign: int) -> Callable[[Array], tuple[Array, Array]]:
        inputs = _at(model, dataset, alpha)
        return lambda thetas: _peak(alpha, sign * model.predict(thetas, *inputs))

    # In ISO-W the force is negative at positive slip angles.
    positive, negative = peak(grids[0], -1), peak(grids[1], 1)
    quantities = [
        Derived("cornering stiffness at zero slip", "N/rad", stiffness),
        Derived("peak force, alpha > 0", "N", lambda thetas: -positive(thetas)[1]),
        Derived("slip angle at peak, alpha > 0", "rad", lambda thetas: positive(thetas)[0]),
        Derived("peak force, alpha < 0", "N", lambda thetas: negative(thetas)[1]),
        Derived("slip angle at peak, alpha < 0", "rad", lambda thetas: negative(thetas)[0]),
    ]
    # The closed form, for models that have its parameters.
    names = list(model.parameters)
    if {"B", "C", "D"} <= set(names):
        BCD = [names.index(name) for name in "BCD"]
        product = Derived(
            "cornering stiffness B C D (Eq. 14)",
            "N/rad",
            lambda thetas: np.asarray(thetas[:, BCD].prod(axis=1)),
        )
        quantities.insert(0, product)
    # Friction: at one load the friction of the tire, over several loads a mean.
    if "Fz" in dataset.columns:
        load = float(np.median(dataset["Fz"]))
        one_load = "Fz" in model.inputs or np.ptp(dataset["Fz"]) <= SAME * load
        name = f"peak friction at Fz = {load:.0f} N"
        if not one_load:
            name = f"mean peak force over the median load, {load:.0f} N"
        quantities.append(
            Derived(
                name,
                "-",
                lambda thetas: (positive(thetas)[1] + negative(thetas)[1]) / (2 * load),
            )
        )
    return _signed(quantities) if _is_tire(model) else tuple(quantities)


def _torque(model: Model, dataset: Dataset) -> tuple[Derived, ...]:
    """The peak of a torque curve."""
    speed = np.linspace(dataset["omega"].min(), dataset["omega"].max(), GRID)

    def peak(thetas: Array) -> tuple[Array, Array]:
        return _peak(speed, model.predict(thetas, *_at(model, dataset, speed)))

    return (
        Derived("peak torque within the data", "Nm", lambda thetas: peak(thetas)[1]),
        Derived("engine speed at peak torque", "rad/s", lambda thetas: peak(thetas)[0]),
    )


def _peak(x: Array, y: Array) -> tuple[Array, Array]:
    """Positions (n,) and values (n,) of the maxima of rows y (n, G) over an even grid x (G,).

    They come from a parabola through the three highest points, and are NaN for a row whose largest
    value is at an end.
    """
    top = y.argmax(axis=1)
    inside = (top > 0) & (top < x.size - 1)
    middle = np.clip(top, 1, x.size - 2)
    rows = np.arange(len(y))
    before, at, after = y[rows, middle - 1], y[rows, middle], y[rows, middle + 1]
    bend = before - 2 * at + after
    shift = np.divide(before - after, 2 * bend, out=np.zeros_like(bend), where=bend != 0)
    height = at - (before - after) * shift / 4
    return (
        np.where(inside, x[middle] + shift * (x[1] - x[0]), np.nan),
        np.where(inside, height, np.nan),
    )
