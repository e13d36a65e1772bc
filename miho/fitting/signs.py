"""Data of models with a sign convention: converted to the signs of the model, and checked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from miho.fitting.arguments import Stated, signed_model
from miho.models.model import Model
from miho.optim import Parameter, Space
from miho.quantities import Array


def in_signs_of(
    model: Model,
    inputs: dict[str, Array],
    output: Array,
    convention: str,
    ranges: Mapping[str, Sequence[float] | None] | None,
    stated: Stated,
) -> tuple[dict[str, Array], Array]:
    """Input and output columns (N,) in the signs of the model.

    `stated` is known about parameters. Raises ValueError for impossible columns, and for a
    convention or ranges of a model without signs.
    """
    signed = signed_model(model)
    if signed is not None:
        signed.check_data(inputs, output, convention, ranges, largest_values(stated))
        return signed.converted(inputs, output, convention)
    if convention != "iso-w" or ranges:
        raise ValueError("convention and ranges: expected for the data of a tire only; remove them")
    return inputs, output


def largest_values(stated: Stated) -> dict[str, float]:
    """The largest value of each parameter that bounds, starts and fixed values allow.

    It is infinite if they do not say; later ones take precedence.
    """
    largest: dict[str, float] = {}
    for values in stated:
        named = {p.name: p for p in values.parameters} if isinstance(values, Space) else values
        if isinstance(named, Mapping):  # anything else is refused later
            largest |= {name: _largest(value) for name, value in named.items()}
    return largest


def _largest(value: Any) -> float:
    """The largest value by bounds, a `Parameter`, a mapping of its settings, or numbers."""
    settings = vars(value) if isinstance(value, Parameter) else value
    if isinstance(settings, Mapping):
        fixed = settings.get("fixed")
        value = settings.get("high") if fixed is None else fixed
    try:
        return float(np.max(value))
    except (TypeError, ValueError):  # an expression, or bounds that are refused later
        return math.inf
