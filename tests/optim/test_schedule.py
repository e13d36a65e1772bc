"""The bracket table against exact fractions and the table Hyperband's authors published."""

import math
import random
from fractions import Fraction
from itertools import count

import pytest

from miho.optim import hyperband_table
from miho.optim.schedule import largest_bracket


def reference(R: int, eta: int, rounding: str) -> list[tuple[int, int, int, int]]:
    """Alg. 1, lines 1-6, in exact rational arithmetic, as literally as possible."""
    at_least = next(s for s in count() if Fraction(eta) ** s >= R)
    s_max = at_least if rounding == "ceil" or Fraction(eta) ** at_least == R else at_least - 1
    B = Fraction((s_max + 1) * R)
    rows = []
    for s in reversed(range(s_max + 1)):
        n = math.ceil(B / R * Fraction(eta) ** s / (s + 1))
        r = R * Fraction(eta) ** -s
        for j in range(s + 1):
            n_j = max(1, math.floor(n * Fraction(eta) ** -j))
            rows.append((s, j, n_j, math.floor(r * Fraction(eta) ** j)))
    return rows


def rows(R: int, eta: int, rounding: str) -> list[tuple[int, int, int, int]]:
    return [(g.s, g.j, g.n, g.mutations) for g in hyperband_table(R, eta, rounding)]


@pytest.mark.parametrize("rounding", ["ceil", "floor"])
@pytest.mark.parametrize("eta", range(2, 11))
def test_powers(eta: int, rounding: str) -> None:
    for k in range(13):
        assert rows(eta**k, eta, rounding) == reference(eta**k, eta, rounding)
        assert largest_bracket(eta**k, eta, rounding) == k


@pytest.mark.slow
def test_random_pairs() -> None:
    rng = random.Random(0)
    for _ in range(1000):
        R, eta = rng.randint(1, 10 ** rng.randint(1, 9)), rng.randint(2, 10)
        for rounding in ("ceil", "floor"):
            assert rows(R, eta, rounding) == reference(R, eta, rounding)


def test_published_table() -> None:
    """Li et al. (2018), Table 1: R = 81, eta = 3."""
    published = {
        4: [(81, 1), (27, 3), (9, 9), (3, 27), (1, 81)],
        3: [(34, 3), (11, 9), (3, 27), (1, 81)],
        2: [(15, 9), (5, 27), (1, 81)],
        1: [(8, 27), (2, 81)],
        0: [(5, 81)],
    }
    for s, expected in published.items():
        rungs = [(g.n, g.mutations) for g in hyperband_table(81, 3, "floor") if g.s == s]
        assert rungs == expected


def test_paper_preset_sizes() -> None:
    """R = 10^4, eta = 5: neither rounding gives the "n = 10^4" of the text."""
    first_printed, second_printed = hyperband_table(10_000, 5, "ceil")[:2]
    assert (first_printed.s, first_printed.n, first_printed.mutations) == (6, 15625, 0)
    assert (second_printed.n, second_printed.mutations) == (3125, 3)
    assert hyperband_table(10_000, 5, "floor")[0].n == 3125


@pytest.mark.parametrize("rounding", ["ceil", "floor"])
def test_mutations_stay_within_the_budget(rounding: str) -> None:
    """No bracket spends more than B = (s_max + 1) R on mutations."""
    rng = random.Random(1)
    for _ in range(1000):
        R, eta = rng.randint(1, 10**6), rng.randint(2, 10)
        table = hyperband_table(R, eta, rounding)
        s_max = table[0].s
        for s in range(s_max + 1):
            assert sum(g.n * g.mutations for g in table if g.s == s) <= (s_max + 1) * R


@pytest.mark.parametrize(("R", "eta"), [(0, 3), (-1, 3), (9, 1), (9, 0), (9.0, 3), (True, 2)])
def test_bad_settings(R: int, eta: int) -> None:
    with pytest.raises(ValueError, match="expected a whole number"):
        hyperband_table(R, eta)
