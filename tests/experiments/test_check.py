"""The figures of `experiments.check` that take seconds; docs/results.md gives them in full."""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest
from scipy.stats import binom

from experiments.app.compose import composed
from experiments.check import coverage, optima

pytestmark = pytest.mark.slow


def test_intervals_hold_the_truth() -> None:
    """Nominally 95 of 100 sets; a binomial of that is below the limit once in ten thousand."""
    sets = 60
    least = binom.ppf(1e-4, sets, 0.95) / sets
    table = coverage.coverage(sets, bootstrapped=0, replicates=0).set_index("interval")
    shares = table.drop(columns="sets").map(lambda cell: float(cell.partition(" ")[0]) / 100)
    assert set(shares.index) == {"linearised", "profile"}
    assert shares.to_numpy().min() >= least


def test_intervals_of_a_drive_hold_the_truth_where_those_of_independent_rows_do_not() -> None:
    """92 of 100 sets at least, against less than 70: each limit is passed by chance in one of ten
    thousand."""
    sets = 60
    least, most = binom.ppf(1e-4, sets, 0.92) / sets, binom.isf(1e-4, sets, 0.7) / sets
    table = coverage.coverage(sets, bootstrapped=0, replicates=0, correlation=0.8)
    shares = table.set_index("interval").drop(columns="sets")
    shares = shares.map(lambda cell: float(cell.partition(" ")[0]) / 100)
    assert shares.loc["for independent rows"].max() <= most
    assert shares.loc[["linearised", "profile"]].to_numpy().min() >= least


def test_coverage_of_linear_models_on_other_noise() -> None:
    """As above; white noise loses nothing by a look at its neighbours."""
    least = binom.ppf(1e-4, 200, 0.92) / 200
    for noise in ("white", "AR(2) 1.3, -0.6"):
        for columns in coverage.DESIGNS:
            row = coverage.held(noise, columns, 300, 200)
            assert float(str(row["report"]).partition(" ")[0]) / 100 >= least, row


@pytest.mark.parametrize("name", ["tire_lf", "torque_05", "brake_static"])
def test_recorded_optima_are_found_anew(name: str) -> None:
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        optimum = optima.optimum_of(name, 20, pool)
    recorded = composed([f"problem={name}"]).problem.optimum
    assert recorded is not None
    assert optima.verdict(optimum, recorded) == ""
