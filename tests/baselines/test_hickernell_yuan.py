"""The multi-start of Hickernell and Yuan: its counts, its starts, its end, and what it finds."""

import numpy as np
import pytest

from miho import Budget, Oracle, minimize
from miho.methods.hickernell_yuan import HickernellYuan, towards_zero
from miho.optim import Outcome
from miho.quantities import Array
from miho.testing import DecayFit
from tests.baselines.test_least_squares import Blind
from tests.identification.published import mgh09, misra1a


@pytest.mark.parametrize(("problem", "rows", "certified"), [
    (misra1a(), 14, 1.2455138894e-1), (mgh09(), 11, 3.0750560385e-4),
])  # fmt: skip
def test_it_ends_by_itself_at_the_certified_minimum(
    problem: DecayFit, rows: int, certified: float
) -> None:
    record = minimize(HickernellYuan(), problem, seed=1)
    assert record.outcome is Outcome.CONVERGED
    assert record.loss * rows == pytest.approx(certified, rel=1e-8)


def test_it_ends_as_gslnls_says() -> None:
    """NSP >= mstart_minsp and NWSP > mstart_r + sqrt(mstart_r) NSP."""
    method = HickernellYuan(r=4.0, least=1)
    assert [method.converged(1, worse) for worse in (0, 6, 7)] == [False, False, True]
    assert [method.converged(3, worse) for worse in (10, 11)] == [False, True]
    assert not method.converged(0, 1000)
    assert not HickernellYuan(least=2).converged(1, 1000)


def test_a_run_ends_when_it_has_counted_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    counts: list[tuple[int, int]] = []
    converged = HickernellYuan.converged

    def watched(self: HickernellYuan, stationary: int, worse: int) -> bool:
        counts.append((stationary, worse))
        return converged(self, stationary, worse)

    monkeypatch.setattr(HickernellYuan, "converged", watched)
    method = HickernellYuan()
    record = minimize(method, misra1a(), seed=2)
    assert record.descents is not None
    assert [converged(method, *pair) for pair in counts] == [False] * (len(counts) - 1) + [True]
    assert counts[0] == (0, 0), "nothing is retained twice in the first iteration"
    stationary, worse = counts[-1]
    assert stationary >= 1
    assert worse > 4 + 2 * stationary
    assert record.descents.started >= stationary + 1, "each by a search, and one more at the end"


def test_starts_are_drawn_to_the_smallest_values() -> None:
    """Of 10 to 26, around 0 and of -26 to -10, by a power of 1/2: 2 (sqrt(1 + a) - 1) from there.

    A power of 1 changes nothing.
    """
    low, high = np.array([10.0, -8.0, -26.0]), np.array([26.0, 8.0, -10.0])
    coordinates = np.array([[25.0, 8.0, -25.0], [10.0, -3.0, -10.0]])
    transformed = towards_zero(coordinates, low, high, np.full(3, 0.5))
    np.testing.assert_allclose(transformed, [[16.0, 4.0, -16.0], [10.0, -2.0, -10.0]])
    np.testing.assert_allclose(towards_zero(coordinates, low, high, np.ones(3)), coordinates)


def test_points_without_full_rank_are_dropped() -> None:
    """Each costs a look and its derivatives, and nothing is searched from."""
    record = minimize(HickernellYuan(major=2), Blind(), seed=1)
    assert record.outcome is Outcome.CONVERGED
    assert record.evaluations == 2 * 30 * (1 + 4)
    assert record.descents is None


def test_retained_points_are_concentrated_again() -> None:
    """q of N stay for the second iteration; the others are new."""
    starts: list[Array] = []

    class Watched(HickernellYuan):
        def _search(self, oracle, start, iterations, record):  # type: ignore[no-untyped-def]
            result = super()._search(oracle, start, iterations, record)
            starts.append(start.copy())
            ends.append(result[0].theta)
            return result

    ends: list[Array] = []
    oracle = Oracle(DecayFit(), Budget())
    Watched(N=10, q=3, major=2).run(oracle, np.random.default_rng(1))
    continued = {tuple(start) for start in starts[10:20]} & {tuple(end) for end in ends[:10]}
    assert len(continued) == 3


def test_unusable_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="q is 31; expected at most N, 30"):
        HickernellYuan(q=31)
    with pytest.raises(ValueError, match="r is 0"):
        HickernellYuan(r=0.0)
