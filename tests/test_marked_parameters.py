"""The printed line marks parameters that are at a bound or have no finite standard error."""

# mypy: disable-error-code="no-untyped-def"
import numpy as np
import pytest

import miho
from tests.printed import flat

T = np.linspace(0, 3, 50)
Y = 2 * np.exp(-1.5 * T) + np.random.default_rng(0).normal(0, 0.05, 50)


def decay(t, a, b):
    return a * np.exp(-b * t)


decay.__annotations__ = {"a": "V", "b": "1/s"}


def with_idle(t, a, b, c):
    return a * np.exp(-b * t) + 0 * c


def line_of(fit: miho.Fit) -> str:
    """The line below the table, without breaks."""
    words = flat(str(fit)[str(fit).index("\nerror ") :])
    return words.split(" Converged")[0].split(" - ")[0]


@pytest.mark.parametrize(
    ("bounds", "mark"),
    [
        ({"a": (0, 1.5), "b": (0, 10)}, "; a = 1.5 V (at its upper bound); "),
        ({"a": (0, 5), "b": (1.7, 10)}, "; b = 1.7 1/s (at its lower bound); "),
        ({"a": (0, 5), "b": (0, 10)}, ""),
    ],
)
def test_a_parameter_at_its_bound_is_marked(bounds: dict, mark: str) -> None:
    line = line_of(miho.fit(decay, T, Y, bounds))
    assert mark in line
    assert line.count("bound)") == bool(mark)
    assert "not determined" not in line


def test_a_parameter_without_a_finite_error_is_marked() -> None:
    fit = miho.fit(with_idle, T, Y, {"a": (0, 5), "b": (0, 10), "c": (0, 10)})
    assert f"; c = {fit.values['c']:.5g} (± not determined); " in line_of(fit)
    assert line_of(fit).count("determined") == 1


def test_without_standard_errors_every_parameter_is_marked() -> None:
    line = line_of(miho.fit(decay, T[:2], Y[:2], {"a": (0, 5), "b": (0, 10)}))
    assert line.count("(± not determined)") == 2


def test_fixed_parameters_are_not_marked_and_tied_ones_are() -> None:
    def four(t, a, b, c, d):
        return a * np.exp(-b * t) + 0 * c + 0 * d

    bounds = {"a": (0, 5), "b": (0, 10), "c": (0, 10)}
    line = line_of(miho.fit(four, T, Y, bounds, tied={"d": "2 * c"}))
    assert "; c = " in line
    assert "; d = " in line
    assert line.count("(± not determined)") == 2
    assert "determined" not in line_of(miho.fit(four, T, Y, bounds, fixed={"c": 1, "d": 2}))
