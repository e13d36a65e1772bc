"""A tire, or its property file, as the model of a fit of Fx, Fy or Mz."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from typing import Any

from miho.optim import Space
from miho.vehicle.models.magic_formula import MagicFormula
from miho.vehicle.models.tire_formula import TireFormula, is_coefficient, tire_formula


def tire_model(
    tire: MagicFormula | str | os.PathLike[str],
    x: Any,
    y: Any,
    space: Space | Mapping[str, Any] | Collection[str],
    start: Mapping[str, float] | None,
    fixed: Mapping[str, float],
    tied: Mapping[str, str],
) -> tuple[TireFormula, Space | Mapping[str, Any] | None, Mapping[str, float] | None]:
    """Return the model of a tire or of its file, with bounds and start, as `miho.fit` needs them.

    A coefficient that is only named starts at the value of the tire. If coefficients are tied, the
    space may have parameters that are not coefficients.
    """
    if not isinstance(y, str) or not (isinstance(x, Mapping) or hasattr(x, "columns")):
        raise ValueError(
            "x and y of a tire: expected columns by name as x and the name of one of them, Fx, Fy "
            "or Mz, as y"
        )
    space = [space] if isinstance(space, str) else space
    bounded = isinstance(space, Space | Mapping)
    named = space.names if isinstance(space, Space) else tuple(space)
    extra = {name for name in named if bounded and tied and not is_coefficient(name)}
    names = dict.fromkeys([*named, *(start or ()), *fixed, *tied])
    model = tire_formula(tire, [name for name in names if name not in extra], [*x], y)
    if isinstance(space, Space | Mapping):
        return model, space, start
    own = model.own_values()
    return model, None, {name: own[name] for name in named} | dict(start or {})
