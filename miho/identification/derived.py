"""Derived quantities of a fitted model, with standard errors by the delta method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from miho.data.dataset import Dataset
from miho.identification.uncertainty import Linearised
from miho.models.derived import Derived
from miho.models.joint import parts_of
from miho.models.layout import PART
from miho.models.model import Model
from miho.models.tied import Tied
from miho.quantities import Array

STEP = 1e-6
"""Smallest step of differences, as a fraction of a parameter."""
UNCHANGED = 1e-9
"""A relative change of a quantity up to this is rounding: a quantity that is proportional to a
parameter changes by at least STEP."""


def derived(model: Model, dataset: Dataset) -> tuple[Derived, ...]:
    """The derived quantities of a model, which may depend on its data.

    Fixed and tied parameters come first. A joint model has the quantities of each part.
    """
    if isinstance(model, Tied):
        return _tied(model, dataset)
    if parts_of(model):
        return _of_parts(model, dataset)
    return model.derived_quantities(dataset.columns)


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


def delta_method(quantity: Derived, at: Linearised) -> tuple[float, float]:
    """Value and standard error of a derived quantity, to first order in the parameters.

    The error is NaN if the quantity depends only on parameters at a bound.
    """
    value = float(quantity.evaluate(at.theta[None])[0])
    return value, float(at.spread(_slopes(quantity, at)[None])[0])


def interval_of(quantity: Derived, at: Linearised, level: float) -> Array:
    """The linearised interval (1, 2) of a derived quantity."""
    value, error = delta_method(quantity, at)
    reach = float(at.quantiles(gradient(quantity, at)[None], level)[0]) * error
    return np.array([[value - reach, value + reach]])


def is_held(quantity: Derived, at: Linearised) -> bool:
    """Whether a derived quantity depends on parameters, all of which are at a bound."""
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
