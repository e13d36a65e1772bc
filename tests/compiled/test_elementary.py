"""The compiled sine, cosine and arctangent against mpmath with 40 digits."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pytest
from numba import njit
from numpy.typing import NDArray

import miho.compiled.polynomials  # noqa: F401 -- registers the compiled forms
from miho.compiled import elementary

Array = NDArray[np.float64]

NAMES = ("sin", "cos", "atan")
REDUCED = 2.0**40
"""Sine and cosine keep their bound up to here."""
LARGEST = 2.0**45
"""Beyond it they are NaN."""
ABSOLUTE = 2.3e-16
TAN_PI_8, TAN_3PI_8 = math.tan(math.pi / 8), math.tan(3 * math.pi / 8)


@njit(error_model="numpy")
def all_three(x: Array, sines: Array, cosines: Array, angles: Array) -> None:
    sines[:] = elementary.sin(x)
    cosines[:] = elementary.cos(x)
    angles[:] = elementary.atan(x)


def compiled(x: Array) -> dict[str, Array]:
    values = [np.empty_like(x) for _ in NAMES]
    all_three(x, *values)
    return dict(zip(NAMES, values, strict=True))


def error(name: str, x: Array) -> tuple[Array, Array]:
    """Absolute error of the compiled function, and the size of a unit in its last place."""
    function: Callable[[Any], Any] = getattr(mpmath, name)
    with mpmath.workdps(40):
        exact = [function(mpmath.mpf(value)) for value in x.tolist()]
        pairs = zip(exact, compiled(x)[name].tolist(), strict=True)
        off = [abs(float(mpmath.mpf(computed) - value)) for value, computed in pairs]
        return np.array(off), np.spacing(np.abs([float(value) for value in exact]))


def around(x: Array) -> Array:
    """The numbers, their neighbours above and below, and all that negated."""
    near = np.concatenate([np.nextafter(x, -np.inf), x, np.nextafter(x, np.inf)])
    return np.concatenate([near, -near])


def arguments() -> dict[str, Array]:
    """Every magnitude used; where the result passes zero; where numbers are smallest."""
    rng = np.random.default_rng(0)
    sign = rng.choice([-1.0, 1.0], 2000)
    far = rng.integers(1, int(REDUCED / math.pi), 500)
    multiples = np.concatenate([np.arange(300), 2 * far, 2 * far + 1]) * (math.pi / 2)
    return {
        "magnitudes": sign * 2 ** rng.uniform(-12, 40, 2000),
        "two periods": rng.uniform(-4 * math.pi, 4 * math.pi, 2000),
        "multiples of pi/2": around(multiples[multiples <= REDUCED]),
        "tiny": around(2.0 ** -np.arange(1.0, 1075.0, 7)),
        "denormal": around(np.array([5e-324, 1e-320, 2.2250738585072014e-308])),
        "end of the range": around(np.array([0.999, 1.0]) * np.nextafter(REDUCED, 0)),
    }


@pytest.mark.parametrize("name", ["sin", "cos"])
@pytest.mark.parametrize("kind", arguments())
def test_sine_and_cosine_keep_their_bound(name: str, kind: str) -> None:
    off, unit = error(name, arguments()[kind])
    assert (off <= ABSOLUTE + unit).all()


@pytest.mark.parametrize("name", ["sin", "cos"])
def test_sine_and_cosine_degrade_gently_up_to_their_end(name: str) -> None:
    """The reduced argument leaves the polynomial's interval by up to pi 2^45 2^-53: 2 per cent."""
    rng = np.random.default_rng(1)
    off, _ = error(name, rng.uniform(REDUCED, LARGEST, 2000))
    assert off.max() < 1e-14


def test_arctangent_is_within_three_units_everywhere() -> None:
    rng = np.random.default_rng(2)
    x = np.concatenate(
        [
            arguments()["magnitudes"],
            np.tan(rng.uniform(-1.5707, 1.5707, 3000)),
            rng.uniform(TAN_PI_8, 0.5, 5000),  # where the two terms of the result cancel most
            around(np.array([TAN_PI_8, 1.0, TAN_3PI_8])),
            arguments()["tiny"],
            arguments()["denormal"],
            around(np.array([1e20, 1e300])),
        ]
    )
    off, unit = error("atan", x)
    assert (off <= 3 * unit).all()
    assert off.max() > 0


def test_arctangent_rises_across_its_branches() -> None:
    for branch in (TAN_PI_8, TAN_3PI_8):
        x = branch * (1 + 1e-12 * np.arange(-500, 501))
        assert (np.diff(compiled(x)["atan"]) > 0).all()


def test_ends_and_zeros() -> None:
    values = compiled(np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 5e-324, -5e-324]))
    assert values["atan"].tolist()[:4] == [0.0, 0.0, math.pi / 2, -math.pi / 2]
    assert np.signbit(values["atan"]).tolist()[:4] == [False, True, False, True]
    assert values["sin"].tolist()[:2] == [0.0, 0.0]
    assert values["cos"].tolist()[:2] == [1.0, 1.0]
    for name in ("sin", "cos"):
        assert np.isnan(values[name][2:5]).all()
    assert np.isnan(values["atan"][4])
    for name in ("sin", "atan"):
        assert values[name].tolist()[5:] == [5e-324, -5e-324]


def test_beyond_the_largest_argument_there_is_no_sine() -> None:
    beyond = np.array([LARGEST, np.nextafter(LARGEST, np.inf), -1e300])
    for name in ("sin", "cos"):
        assert np.isnan(compiled(beyond)[name]).tolist() == [False, True, True]


def test_from_python_they_are_numpys() -> None:
    x = np.linspace(-5, 5, 11)
    assert np.array_equal(elementary.sin(x), np.sin(x))
    assert np.array_equal(elementary.cos(x), np.cos(x))
    assert np.array_equal(elementary.atan(x), np.arctan(x))
