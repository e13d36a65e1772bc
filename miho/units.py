"""Units, their spellings, and their conversion to SI."""

from __future__ import annotations

from difflib import get_close_matches
from math import pi
from types import MappingProxyType
from typing import NamedTuple

from miho.quantities import g

OWN = "own:"


class Unit(NamedTuple):
    """The SI unit (`name`) of a unit and the factor that converts values to it."""

    name: str
    factor: float


_KILO, _MILLI, _DEGREE, _HOUR = 1e3, 1e-3, pi / 180, 3600.0
_INCH, _POUND = 0.0254, 7000 * 64.79891e-6  # 7000 grains
_FOOT, _POUND_FORCE = 12 * _INCH, _POUND * g
_TABLE: dict[str, dict[str, float]] = {
    "-": {"-": 1.0, "1": 1.0, "%": 0.01},
    "rad": {"rad": 1.0, "deg": _DEGREE, "mrad": _MILLI},
    "rad/s": {"rad/s": 1.0, "deg/s": _DEGREE, "rpm": 2 * pi / 60.0},
    "rad/s^2": {"rad/s^2": 1.0, "rad/s2": 1.0, "deg/s^2": _DEGREE},
    "1/rad": {"1/rad": 1.0, "1/deg": 1 / _DEGREE},
    "N": {"N": 1.0, "kN": _KILO, "daN": 10.0, "lbf": _POUND_FORCE, "kgf": g},
    "N/rad": {
        "N/rad": 1.0, "N/deg": 1 / _DEGREE, "kN/rad": _KILO,
        "kN/deg": _KILO / _DEGREE,
    },
    "Nm": {"Nm": 1.0, "kNm": _KILO, "lbf-ft": _POUND_FORCE * _FOOT},
    "Nm/rad": {"Nm/rad": 1.0, "Nm/deg": 1 / _DEGREE},
    "Pa": {
        "Pa": 1.0, "kPa": _KILO, "MPa": 1e6, "bar": 1e5, "psi": _POUND_FORCE / _INCH**2,
    },
    "s": {"s": 1.0, "us": 1e-6, "ms": _MILLI, "min": 60.0, "h": _HOUR},
    "1/s": {"1/s": 1.0, "Hz": 1.0},
    "m": {
        "m": 1.0, "mm": _MILLI, "cm": 1e-2, "km": _KILO, "in": _INCH,
        "ft": _FOOT,
    },
    "1/m": {"1/m": 1.0},
    "m/s": {
        "m/s": 1.0, "mm/s": _MILLI, "km/h": _KILO / _HOUR, "mph": 1760 * (3 * _FOOT) / _HOUR,
        "ft/s": _FOOT,
    },
    "m/s^2": {"m/s^2": 1.0, "m/s2": 1.0, "g0": g},
    "N/m": {"N/m": 1.0, "N/mm": _KILO, "kN/m": _KILO},
    "kg": {"kg": 1.0, "lb": _POUND},
    "kg/s": {"kg/s": 1.0, "g/s": _MILLI, "kg/h": 1 / _HOUR},
    "kg m^2": {"kg m^2": 1.0, "kg m2": 1.0},
    "V": {"V": 1.0, "mV": _MILLI},
    "A": {"A": 1.0, "mA": _MILLI},
    "W": {"W": 1.0, "kW": _KILO},
    "J": {"J": 1.0, "kJ": _KILO},
    "K": {"K": 1.0},
}  # fmt: skip

UNITS = MappingProxyType(
    {
        spelling: Unit(name, factor)
        for name, spellings in _TABLE.items()
        for spelling, factor in spellings.items()
    }
)
"""All known spellings."""

_OTHER_SPELLINGS = MappingProxyType(
    {
        "degree": "deg", "degrees": "deg", "°": "deg", "radian": "rad", "radians": "rad",
        "newton": "N", "newtons": "N", "lbs": "lbf", "n m": "Nm", "n*m": "Nm", "n-m": "Nm",
        "ft-lb": "lbf-ft", "ft-lbf": "lbf-ft", "kph": "km/h", "kmh": "km/h", "g": "g0",
        "1/min": "rpm", "percent": "%", "sec": "s", "m/s²": "m/s^2", "rad/s²": "rad/s^2",
        "m/s/s": "m/s^2", "inch": "in",
        "meter": "m", "metre": "m", "": "-", "none": "-", "none/unitless": "-",
    }
)  # fmt: skip


def differ(unit: str, other: str) -> bool:
    """Return whether two units differ; spellings of one unit do not, nor do unknown units ("").

    Examples
    --------
    >>> differ("Hz", "1/s"), differ("N*m", "Nm"), differ("N", "kN"), differ("N", "")
    (False, False, True, False)
    """
    return unit != other and bool(unit and other) and _known(unit) != _known(other)


def _known(unit: str) -> Unit | str:
    """The SI unit and factor of a spelling, or the spelling itself if it is unknown."""
    usual = unit if unit in UNITS else _OTHER_SPELLINGS.get(unit.strip().casefold(), unit)
    return UNITS.get(usual, unit)


def si(unit: str) -> Unit:
    """Return the SI unit of `unit` and the conversion factor.

    Spellings are exact, because case matters: mN is not MN. A unit that is not in `UNITS` is
    refused with a suggestion. Write a custom unit, for example kmol, as "own:kmol"; it is not
    converted. Temperatures are differences, so only K is known.

    Parameters
    ----------
    unit : str
        A spelling in `UNITS`, or a custom unit.

    Returns
    -------
    Unit
        Name and factor.

    Raises
    ------
    ValueError
        If the unit is unknown.

    Examples
    --------
    >>> from miho.units import si
    >>> si("km")
    Unit(name='m', factor=1000.0)
    """
    if not isinstance(unit, str):
        raise ValueError(f"unit is {unit!r}; give it in quotes, for example 'N'")
    if unit in UNITS:
        return UNITS[unit]
    own = unit.removeprefix(OWN)
    if own != unit and own and own == own.strip() and own.isprintable():
        if own in UNITS and UNITS[own] != Unit(own, 1.0):
            raise ValueError(f"unit {unit!r} is known as {own!r}; write that to have it converted")
        return Unit(own, 1.0)
    plain = unit.strip().casefold()
    suggestions = [spelling for spelling in UNITS if spelling.casefold() == plain]
    if plain in _OTHER_SPELLINGS:
        suggestions.append(_OTHER_SPELLINGS[plain])
    suggestions += get_close_matches(unit, UNITS, n=1)
    if suggestions:
        raise ValueError(
            f"unit {unit!r} is unknown; did you mean {suggestions[0]!r}? (a custom unit is "
            f"written '{OWN}{own.strip() or 'kmol'}' and not converted)"
        )
    raise ValueError(
        f"unit {unit!r} is unknown; known are {', '.join(UNITS)}; a custom unit is written "
        f"'{OWN}{own.strip() or 'kmol'}' and not converted"
    )
