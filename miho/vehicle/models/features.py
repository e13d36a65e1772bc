"""Features of identified curves: stiffness, peaks and friction of tires, peak of a torque curve."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from miho.models.derived import Derived
from miho.models.model import Model
from miho.quantities import Array

REACH = 1.5
"""The search for peaks extends to this multiple of the largest slip angle in the data."""
GRID = 601
SAME = 0.1
"""Loads count as one load if they are within this fraction of each other."""
WRONG_SIGN = (
    "a sign that no tire has in ISO-W signs: check signs, offsets and delays of the columns, and "
    "whether the data reach zero slip."
)


def tire_features(model: Model, columns: Mapping[str, Array]) -> tuple[Derived, ...]:
    """Return stiffness and peaks of a lateral force over alpha, and friction if there is Fz.

    Further inputs of the model are fixed at their median in the columns.
    """
    reach = REACH * float(np.abs(columns["alpha"]).max())
    grids = np.linspace(0, reach, GRID), np.linspace(-reach, 0, GRID)  # alpha > 0, alpha < 0
    h = 1e-4 * reach  # step of the derivative at zero slip

    def stiffness(thetas: Array) -> Array:
        force = model.predict(thetas, *_at(model, columns, np.array([-h, h])))
        return np.asarray((force[:, 0] - force[:, 1]) / (2 * h))

    def peak(alpha: Array, sign: int) -> Callable[[Array], tuple[Array, Array]]:
        inputs = _at(model, columns, alpha)
        return lambda thetas: _peak(alpha, sign * model.predict(thetas, *inputs))

    # In ISO-W the force is negative at positive slip angles.
    positive, negative = peak(grids[0], -1), peak(grids[1], 1)
    quantities = [
        _signed("cornering stiffness at zero slip", "N/rad", stiffness, 1),
        _signed("peak force, alpha > 0", "N", lambda thetas: -positive(thetas)[1], -1),
        Derived("slip angle at peak, alpha > 0", "rad", lambda thetas: positive(thetas)[0]),
        _signed("peak force, alpha < 0", "N", lambda thetas: negative(thetas)[1], 1),
        Derived("slip angle at peak, alpha < 0", "rad", lambda thetas: negative(thetas)[0]),
    ]
    # The closed form, for models that have its parameters.
    names = list(model.parameters)
    if {"B", "C", "D"} <= set(names):
        BCD = [names.index(name) for name in "BCD"]

        def product(thetas: Array) -> Array:
            return np.asarray(thetas[:, BCD].prod(axis=1))

        quantities.insert(0, _signed("cornering stiffness B C D (Eq. 14)", "N/rad", product, 1))
    # Friction: at one load the friction of the tire, over several loads a mean.
    if "Fz" in columns:
        load = float(np.median(columns["Fz"]))
        one_load = "Fz" in model.inputs or np.ptp(columns["Fz"]) <= SAME * load
        name = f"peak friction at Fz = {load:.0f} N"
        if not one_load:
            name = f"mean peak force over the median load, {load:.0f} N"

        def friction(thetas: Array) -> Array:
            return (positive(thetas)[1] + negative(thetas)[1]) / (2 * load)

        quantities.append(_signed(name, "-", friction, 1))
    return tuple(quantities)


def torque_features(model: Model, columns: Mapping[str, Array]) -> tuple[Derived, ...]:
    """Return the peak of a torque over omega."""
    speed = np.linspace(columns["omega"].min(), columns["omega"].max(), GRID)

    def peak(thetas: Array) -> tuple[Array, Array]:
        return _peak(speed, model.predict(thetas, *_at(model, columns, speed)))

    return (
        Derived("peak torque within the data", "Nm", lambda thetas: peak(thetas)[1]),
        Derived("engine speed at peak torque", "rad/s", lambda thetas: peak(thetas)[0]),
    )


def _signed(name: str, unit: str, evaluate: Callable[[Array], Array], sign: int) -> Derived:
    """Return a quantity that has this sign for every tire."""
    return Derived(name, unit, evaluate, sign=sign, remark=WRONG_SIGN)


def _at(model: Model, columns: Mapping[str, Array], values: Array) -> tuple[Array, ...]:
    """Return input columns with these values of the first input and the medians of the others."""
    others = list(model.inputs)[1:]
    return (values, *(np.full(values.size, np.median(columns[name])) for name in others))


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
