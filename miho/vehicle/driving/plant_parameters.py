"""Numbers of a car for compiled code."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from miho.quantities import Array
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.models.engine_map import EngineMap
from miho.vehicle.models.magic_formula import MagicFormula

Tires = tuple[MagicFormula, MagicFormula, MagicFormula, MagicFormula]
"""Tires front left, front right, rear left, rear right, never mirrored."""


class Engine(NamedTuple):
    """Engine with names and units of `EngineMap`; ratios are engine turns per wheel turn [-]."""

    openings: Array
    speeds: Array
    table: Array
    ratios: Array


def engine_of(vehicle: Vehicle, engine: EngineMap) -> Engine:
    """Return an engine with the gears of a vehicle."""
    ratios = np.array(vehicle.gear_ratios, dtype=float) * vehicle.final_drive
    return Engine(engine.openings.copy(), engine.speeds.copy(), engine.table.copy(), ratios)


def record_of(numbers: Mapping[str, Any]) -> Any:
    """Return a record with the numbers among the values of a mapping, in its order."""
    values = {name: v for name, v in numbers.items() if isinstance(v, Real)}
    dtype = np.dtype([(name, np.float64) for name in values])
    return np.array(tuple(values.values()), dtype=dtype)[()]
