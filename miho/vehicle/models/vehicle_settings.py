"""Vehicle models from plain settings of a configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

from miho.validate import is_number
from miho.vehicle.models.longitudinal import Longitudinal
from miho.vehicle.models.single_track import SingleTrack

T = TypeVar("T", SingleTrack, Longitudinal)

KNOWN = frozenset(field.name for kind in (SingleTrack, Longitudinal) for field in fields(kind))
"""Allowed names of settings: the fields of the single-track and longitudinal models."""


def from_settings(kind: type[T], vehicle: Mapping[str, object]) -> T:
    """Return the model of a kind from settings in SI units; the other kind's fields are allowed."""
    unknown = sorted(set(vehicle) - KNOWN)
    if unknown:
        raise ValueError(f"vehicle.{unknown[0]} is unknown; allowed are {', '.join(sorted(KNOWN))}")
    needed: dict[str, Any] = {}
    for field in fields(kind):
        if field.name not in vehicle:
            raise ValueError(f"vehicle.{field.name} is missing; give it in SI units")
        value = vehicle[field.name]
        if field.name == "gear_ratios":
            if not isinstance(value, list | tuple) or not all(map(is_number, value)):
                raise ValueError(f"vehicle.gear_ratios is {value!r}; expected a list of numbers")
        elif not is_number(value):
            raise ValueError(f"vehicle.{field.name} is {value!r}; expected a number")
        needed[field.name] = value
    try:
        return kind(**needed)
    except ValueError as error:
        raise ValueError(f"vehicle: {error}") from None
