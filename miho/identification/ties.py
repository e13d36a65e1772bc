"""Ties of the parameters of a model to the free parameters of a space."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from miho.models.model import Model
from miho.models.symbolic import arguments_of
from miho.models.tied import Ties
from miho.optim.space import Space
from miho.units import differ

DRAWN = 4096
"""Number of configurations that are drawn to find one within all limits."""


def ties_of(model: Model, space: Space) -> Ties:
    """The expressions that give the parameters of the model from the free ones of a space.

    Raises ValueError for a space that lacks a parameter of the model, has one without an effect,
    has other units, or has no configuration with all tied parameters within their limits.
    """
    name = model.name or type(model).__name__
    if [n for n in space.names if n in model.parameters] != list(model.parameters):
        raise ValueError(space_mismatch(model, space.names))
    for parameter in space.parameters:
        needed = model.parameters.get(parameter.name, "")
        if differ(parameter.unit, needed):
            raise ValueError(
                f"parameter {parameter.name!r} of the space has unit {parameter.unit!r}; model "
                f"{name} needs {needed!r}"
            )
        if parameter.fixed is not None and parameter.name not in model.parameters:
            raise ValueError(
                f"space.{parameter.name}: model {name} has no parameter {parameter.name} to fix; "
                "write it into the expressions"
            )
    values = {p.name: p.fixed if p.tied is None else p.tied for p in space.parameters}
    limits = {p.name: (p.low, p.high) for p in space.parameters if p.tied is not None}
    ties = Ties(
        tuple(model.parameters),
        {p.name: p.unit for p in space.free.parameters},
        {key: value for key, value in values.items() if value is not None},
        {key: ends for key, ends in limits.items() if np.isfinite(ends).any()},
        {p.name: p.unit for p in space.parameters if p.tied and p.name not in model.parameters},
        space.radial,
    )
    needed_symbols = arguments_of(ties.graphs[: len(ties.parameters)])
    for symbol, free in zip(ties.arguments, ties.free, strict=True):
        if symbol.arguments[0] not in needed_symbols:
            raise ValueError(
                f"space.{free}: model {name} has no parameter {free}, and none is tied to it; "
                f"remove it{constants_of(model)}"
            )
    _check_limits(ties, space.free)
    return ties


def _check_limits(ties: Ties, free: Space) -> None:
    """Refuse limits of tied parameters that none of many configurations satisfies."""
    values_of_all = ties.values(free.decode(free.initial(DRAWN, "uniform")))
    within_all = np.ones(DRAWN, dtype=bool)
    for name, (low, high) in ties.limits.items():
        values = values_of_all[:, ties.names.index(name)]
        inside = (values >= low) & (values <= high)
        if not inside.any():
            raise ValueError(
                f"space.{name}.tied: {ties.ties[name]!r} is {np.nanmin(values):.4g} to "
                f"{np.nanmax(values):.4g} in the box of the other parameters; expected values from "
                f"{low:g} to {high:g}; widen a range"
            )
        within_all &= inside
    if not within_all.any():
        raise ValueError(
            f"space: none of {DRAWN:,} configurations keeps {', '.join(ties.limits)} within their "
            "ranges; widen a range"
        )


def space_mismatch(model: Model, declared: Sequence[str]) -> str:
    """The message on a space without the parameters of the model in the order of the model."""
    needed = list(model.parameters)
    lacking = [name for name in needed if name not in declared]
    surplus = [name for name in declared if name not in needed]
    differences = [f"lacks {', '.join(lacking)}"] * bool(lacking)
    differences += [f"also has {', '.join(surplus)}"] * bool(surplus)
    if not differences:
        differences = [f"has them in the order {', '.join(declared)}"]
    remedy = "give it these parameters, or choose a space that has them"
    return (
        f"model {model.name or type(model).__name__} needs the parameters {', '.join(needed)}; the "
        f"space {' and '.join(differences)}; {remedy}{constants_of(model) * bool(surplus)}"
    )


def constants_of(model: Model) -> str:
    """The remedy for bounds of a constant, which only functions of a `Trajectory` have."""
    from miho.models.trajectory import Trajectory

    remedy = "; a constant of its functions becomes a parameter without its default value"
    return remedy * isinstance(model, Trajectory)
