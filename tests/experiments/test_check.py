"""The figures of `experiments.check` that take seconds; docs/results.md says where each stands.

Data and starts have fixed seeds, so that figures repeat to the last digits but one; tolerances are
half of the last digit that docs/results.md gives.
"""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from experiments.app.compose import composed
from experiments.app.schema import register
from experiments.check import (
    brake,
    coverage,
    engine,
    gradient_descent,
    mf61_lateral,
    optima,
    row_order,
)
from experiments.driving.car import identified_engine
from miho.study import single_thread
from miho.vehicle.data import embedded_tire

pytestmark = pytest.mark.slow


def test_curves_and_map_of_the_engine(tmp_path: Path) -> None:
    learned = identified_engine(tmp_path)
    curves = engine.curves(learned)
    np.testing.assert_allclose(curves["RMSE against truth"], [0.5, 1.3, 2.7], atol=0.05)
    # The loss is a sum over some thousand samples: rounding is far below, a wrong end far above.
    assert curves["gap to closed form"].abs().max() < 1e-9
    table = engine.maps(learned).set_index("map")
    # Torques of some 700 Nm are rounded at 1e-13.
    assert table.loc["integrated", "inverse residual"] < 1e-11
    assert table.loc["integrated", "least rise"] > -1e-10, "monotone but for rounding"


def test_force_to_command_to_force() -> None:
    register()
    _, identified = brake.embedded_test()
    forces, model_error, true_error = brake.round_trip_errors(identified)
    assert model_error.max() < 1e-9
    assert true_error[forces >= 0.05 * forces[-1]].max() < 0.0055
    assert true_error[forces >= 0.01 * forces[-1]].max() < 0.0225


def test_mf61_is_identified_from_noisy_samples() -> None:
    register()
    figures = mf61_lateral.identification(
        embedded_tire("lf"), mf61_lateral.configured_space(), starts=3
    )
    assert figures["unseen RMSE against the tire [% of peak]"] < 0.055
    trip = mf61_lateral.round_trips(embedded_tire("lf"))
    # Both are the same formula, rounded some ten times at 1e-16.
    assert max(float(str(trip[key])) for key in ("E per side", "rebuilt from E per side")) < 1e-12


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


def test_the_first_rows_show_what_rare_rows_determine() -> None:
    register()
    problem = row_order.synthetic("rare_load")
    with single_thread(), np.errstate(all="ignore"):
        best = row_order.optimum("rare_load", problem)
        full_rank = {
            kind: sum(row_order.figures("rare_load", problem, best, kind, 20)[0])
            for kind in ("in use", "random")
        }
    assert full_rank == {"in use": 20, "random": 2}


def test_the_papers_gradient_descent_does_not_fall_steadily() -> None:
    """docs/paper.md: the loss rises in 18 of 20 runs. A step across a valley of the wide box raises
    it whatever the last digits are."""
    register()
    table = gradient_descent.steadiness(steps=200, repetitions=5)
    assert list(table["method"]) == ["gbo_small", "gbo_large"]
    rising = [int(cell.partition(" of ")[0]) for cell in table["runs that rise"]]
    assert min(rising) >= 3
    assert (table["best [kN]"] <= table["last [kN]"]).all()
    assert (table["best [kN]"] < table["first [kN]"]).all()
    assert table["best [kN]"].min() > 2.5, "within 200 steps no start is near the optimum"
