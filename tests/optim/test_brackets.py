"""Levels of rows, sizes and starts of brackets."""

import numpy as np
import pytest

from miho.optim import Parameter, Space
from miho.optim.brackets import (
    DECADES,
    TURNS,
    Brackets,
    around,
    by_scale,
    draw_starts,
    luby,
)
from miho.quantities import Array


def scaled(u: Array, parameter: Parameter) -> Array:
    """`by_scale` of one parameter."""
    return by_scale(u[:, None], Space((parameter,)))[:, 0]


def test_luby_is_the_published_sequence() -> None:
    """Luby, Sinclair and Zuckerman 1993, Eq. 1."""
    assert [luby(k) for k in range(1, 16)] == [1, 1, 2, 1, 1, 2, 4, 1, 1, 2, 1, 1, 2, 4, 8]


@pytest.mark.parametrize(
    ("rows", "d", "expected"),
    [
        (3000, 5, (20, 60, 180, 540, 3000)),
        (300, 5, (20, 60, 300)),
        (30, 5, (20, 30)),
        (20, 5, (20,)),
        (7, 5, (7,)),
        (3_000_000, 5, (20, 60, 180, 540, 1620, 3_000_000)),
    ],
)
def test_levels_grow_to_all_rows(rows: int, d: int, expected: tuple[int, ...]) -> None:
    assert Brackets().rows_by_level(rows, d) == expected


def test_the_common_start_leads_and_all_are_in_the_box() -> None:
    space = Space(
        (
            Parameter("a", "V", 0.0, 100.0),
            Parameter("b", "1/s", 0.01, 10.0, scale="log"),
            Parameter("c", "V", -1.0, 4.0),
        ),
        seed=("some problem", 3),
    )
    starts = draw_starts(space, 30, np.random.default_rng(0), 1)
    np.testing.assert_array_equal(starts[0], space.initial(1)[0])
    low, high = space.bounds
    assert ((starts >= low) & (starts <= high)).all()
    later = draw_starts(space, 30, np.random.default_rng(0), 2)
    assert not (starts[0] == later[0]).any()


@pytest.mark.parametrize(
    ("parameter", "near"),
    [
        (Parameter("p", "-", 0.0, 100.0), 0.1),
        (Parameter("p", "-", 2.0, 100.0), 2.0),
        (Parameter("p", "-", -100.0, 0.0), -0.1),
        (Parameter("p", "-", -100.0, -2.0), -2.0),
    ],
)
def test_a_size_is_even_in_logarithm(parameter: Parameter, near: float) -> None:
    u = np.linspace(0, 1, 5)
    values = parameter.low + (parameter.high - parameter.low) * scaled(u, parameter)
    far = parameter.high if near > 0 else parameter.low
    np.testing.assert_allclose(np.sort(values / near), (far / near) ** u, rtol=1e-9)


def test_both_sides_of_zero_are_as_likely() -> None:
    """The last three decades of each."""
    parameter = Parameter("p", "-", -1.0, 100.0)
    values = -1 + 101 * scaled(np.array([0.0, 0.25, 0.499999, 0.500001, 0.75, 1.0]), parameter)
    expected = [-1, -(10**-1.5), -1e-3, 0.1, 10**0.5, 100]
    np.testing.assert_allclose(values, expected, rtol=1e-4)


@pytest.mark.parametrize(
    "parameter",
    [
        Parameter("p", "-", 50.0, 100.0),
        Parameter("p", "-", 0.01, 100.0, scale="log"),
    ],
)
def test_other_ranges_stay_uniform(parameter: Parameter) -> None:
    u = np.linspace(0, 1, 5)
    np.testing.assert_array_equal(scaled(u, parameter), u)


def test_brackets_draw_in_turn_from_four_distributions() -> None:
    """The median of uniform starts is 500; by scale it is half of the decades below 1000."""
    space = Space((Parameter("a", "V", 0.0, 1000.0),))
    medians = [
        float(np.median(draw_starts(space, 3000, np.random.default_rng(k), k)))
        for k in range(1, len(TURNS) * len(DECADES) + 1)
    ]
    by_kind = {kind: medians[k :: len(TURNS)] for k, kind in enumerate(TURNS)}
    assert by_kind["uniform"] == pytest.approx([500] * 4, rel=0.1)  # 5 standard errors of a median
    halves = [10 ** (3 - decades / 2) for decades in DECADES]
    # The median of a logarithm that is even over 12 decades has a standard error of 0.11 of one.
    np.testing.assert_allclose(np.log10(by_kind["scale"]), np.log10(halves), atol=0.5)


def test_starts_around_a_minimum_keep_some_of_its_coordinates() -> None:
    """About half, less the one that is always drawn anew: of six, 2.5 on average."""
    rng = np.random.default_rng(0)
    best, starts = np.zeros(6), rng.uniform(1, 2, (2000, 6))
    kept = (around(best, starts, rng) == 0).sum(axis=1)
    assert kept.max() == 5
    assert kept.min() == 0
    assert kept.mean() == pytest.approx(2.5, abs=0.15)  # five standard errors
    alone = around(best[:1], starts[:, :1], rng)
    np.testing.assert_array_equal(alone, starts[:, :1])
