"""The two sets of least-squares problems in conf/problem, and the rule of their boxes."""

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest
import scipy.optimize

from baselines.problems.posed import posed_problem
from experiments.app.compose import composed
from experiments.app.options import recorded

POSED = {name: posed_problem(name) for name in recorded() if name[:3] in ("mw_", "cr_")}
STARTS = (
    7.20000e+01, 1.12500e+03, 1.16542e+07, 1.16859e+09, 4.98920e+06, 5.00936e+08, 2.42000e+01,
    1.79577e+06, 2.50000e+03, 1.06000e+04, 2.15000e+02, 1.61540e+06, 4.00500e+02, 1.54575e+08,
    4.16817e+01, 1.30623e+03, 5.31317e-03, 1.69361e+09, 1.64308e+01, 2.32337e+06, 2.69042e+01,
    8.15888e+06, 7.36782e+01, 2.05938e+07, 1.03115e+03, 4.17131e+03, 7.92669e+06, 3.08106e+11,
    4.64282e-02, 3.37706e-02, 3.86177e-02, 2.88830e-02, 3.37633e-02, 2.67406e-02, 2.73248e+02,
    1.61741e+01, 2.09342e+00, 1.99685e+02, 9.04000e+02, 1.35600e+03, 1.58200e+03, 1.80800e+03,
    5.65000e+01, 7.05625e+01, 9.86875e+01, 2.53908e+09, 6.87380e+12, 3.36796e+09, 3.73513e+09,
    3.99107e+09, 1.13001e+13, 9.38567e+00, 3.36582e+10,
)  # fmt: skip
"""Sums of squares at the 53 starts, as Moré and Wild print them (testout.dat of BenDFO)."""


def test_the_sets_are_whole() -> None:
    assert Counter(name[:2] for name in POSED) == {"mw": 53, "cr": 36}


@pytest.mark.parametrize("name", POSED)
def test_the_start_lies_inside_the_box(name: str) -> None:
    posed = POSED[name]
    assert posed.start is not None
    ranges = zip(posed.start, posed.ranges.values(), strict=True)
    assert all(low < x < high for x, (low, high, _) in ranges)


@pytest.mark.parametrize(("name", "squares"), [*zip(list(POSED)[:53], STARTS, strict=True)])
def test_the_start_has_the_sum_of_squares_of_more_and_wild(name: str, squares: float) -> None:
    """To the six digits that are printed: half a unit of the last is 5e-6 at most."""
    posed = POSED[name]
    assert posed.start is not None
    assert float((posed.residuals(posed.start) ** 2).sum()) == pytest.approx(squares, rel=6e-6)


def test_the_optimum_of_the_chain_is_that_of_dynamic_programming() -> None:
    """Each pair of neighbours has two residuals, so a pass along the chain meets every basin.

    Steps of the grid are 0.05 to 0.1, and basins are wider by far.
    """
    posed = POSED["cr_freudenstein_roth_10"]
    grids = [np.linspace(low, high, 401) for low, high, _ in posed.ranges.values()]
    least, choices = np.zeros(401), []
    for before, after in pairwise(grids):
        a, b = before[:, None], after[None]
        first, second = a + ((5 - b) * b - 2) * b - 13, a + ((b + 1) * b - 14) * b - 29
        totals = least[:, None] + first**2 + second**2
        choices.append(totals.argmin(axis=0))
        least = totals.min(axis=0)
    path = [int(least.argmin())]
    for choice in reversed(choices):
        path.append(int(choice[path[-1]]))
    x = np.array([grid[k] for grid, k in zip(grids, reversed(path), strict=True)])
    end = scipy.optimize.least_squares(posed.residuals, x, ftol=1e-15, xtol=1e-15, gtol=1e-15).x
    error = np.sqrt(np.mean(posed.residuals(end) ** 2))
    recorded = composed(["problem=cr_freudenstein_roth_10"]).problem.optimum
    assert error == pytest.approx(recorded, rel=1e-8)
