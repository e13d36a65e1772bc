"""Units: every factor against a number nobody computed here, and no misspelling taken."""

import math

import pytest

from miho.units import UNITS, Unit, si

# Definitions: degree, minute, standard gravity, pound, foot and inch (1959 agreement), bar.
BY_DEFINITION = {
    "deg": ("rad", math.pi / 180), "mrad": ("rad", 1e-3), "%": ("-", 0.01),
    "rpm": ("rad/s", 2 * math.pi / 60), "deg/s": ("rad/s", math.pi / 180),
    "1/deg": ("1/rad", 180 / math.pi), "kN": ("N", 1000.0), "kgf": ("N", 9.80665),
    "lbf": ("N", 0.45359237 * 9.80665), "N/deg": ("N/rad", 180 / math.pi),
    "kN/deg": ("N/rad", 180e3 / math.pi), "kNm": ("Nm", 1000.0),
    "lbf-ft": ("Nm", 0.45359237 * 9.80665 * 0.3048), "kPa": ("Pa", 1000.0), "bar": ("Pa", 1e5),
    "psi": ("Pa", 0.45359237 * 9.80665 / 0.0254**2), "ms": ("s", 1e-3), "km/h": ("m/s", 1 / 3.6),
    "mph": ("m/s", 1609.344 / 3600), "g0": ("m/s^2", 9.80665), "in": ("m", 0.0254),
    "ft": ("m", 0.3048), "mm": ("m", 1e-3), "lb": ("kg", 0.45359237), "mV": ("V", 1e-3),
    "N/mm": ("N/m", 1000.0), "deg/s^2": ("rad/s^2", math.pi / 180),
    "us": ("s", 1e-6), "h": ("s", 3600.0), "mm/s": ("m/s", 1e-3), "g/s": ("kg/s", 1e-3),
    "kg/h": ("kg/s", 1 / 3600), "kJ": ("J", 1000.0),
}  # fmt: skip


@pytest.mark.parametrize("unit", BY_DEFINITION)
def test_factors(unit: str) -> None:
    name, factor = BY_DEFINITION[unit]
    assert si(unit).name == name
    assert si(unit).factor == pytest.approx(factor, rel=1e-15)


def test_a_unit_of_the_si_is_itself() -> None:
    for unit in {known.name for known in UNITS.values()}:
        assert si(unit) == Unit(unit, 1.0)


@pytest.mark.parametrize(
    ("unit", "meant"),
    [
        ("kn", "kN"), ("KN", "kN"), ("n", "N"), ("Deg", "deg"), ("degrees", "deg"), ("°", "deg"),
        ("RPM", "rpm"), ("kpa", "kPa"), ("KPA", "kPa"), ("nm", "Nm"), ("N m", "Nm"),
        ("kph", "km/h"), ("kmh", "km/h"), ("KM/H", "km/h"), ("g", "g0"), ("PSI", "psi"),
        ("m/s²", "m/s^2"), ("Rad", "rad"), ("v", "V"), ("", "-"), (" N", "N"), ("KG", "kg"),
    ],
)  # fmt: skip
def test_another_spelling_is_refused_with_the_right_one(unit: str, meant: str) -> None:
    with pytest.raises(ValueError, match="is unknown") as error:
        si(unit)
    assert f"did you mean {meant!r}?" in str(error.value)


def test_an_unknown_unit_lists_the_known_ones() -> None:
    with pytest.raises(ValueError, match="'furlong' is unknown; known are -, 1, %, rad, deg"):
        si("furlong")
    with pytest.raises(ValueError, match="give it in quotes"):
        si(1)  # type: ignore[arg-type]


def test_units_of_your_own_say_so() -> None:
    assert si("own:kmol") == Unit("kmol", 1.0)
    assert si("own:V") == si("V")
    with pytest.raises(ValueError, match="known as 'kN'; write that"):
        si("own:kN")
    for wrong in ("own:", "own: kmol", "own:a\nb", "kmol"):
        with pytest.raises(ValueError, match="a custom unit is written 'own:"):
            si(wrong)
