"""Every optimizer of conf/optimizer passes the conformance suite."""

from pathlib import Path

import pytest
from omegaconf import OmegaConf

from experiments.app.instantiation import instantiate
from miho.optim import Optimizer
from miho.testing import BUDGET, CHECKS, run_check

OPTIMIZERS = sorted((Path(__file__).parent.parent / "conf" / "optimizer").glob("*.yaml"))

SLOW = {
    "optuna_hyperband", "gbo_small", "gbo_large", "pso_500", "pso_constriction",
    "miho_no_mutation", "hyperband", "successive_halving", "nelder_mead", "lbfgsb",
    "least_squares_lm", "variable_projection_lm", "cma_es", "differential_evolution",
    "dual_annealing", "optuna_tpe", "optuna_cmaes", "ngopt", "dehb",
    "least_squares_10", "least_squares_50", "variable_projection_10", "variable_projection_50",
    "hickernell_yuan", "cluster_gauss_newton", "scatter_search", "dfo_ls",
}  # fmt: skip
"""Methods that take seconds a check, or differ from another in a setting alone."""

EVALUATIONS = {
    "optuna_tpe": 150, "optuna_cmaes": 300, "ngopt": 100, "dehb": 100,
    "cma_es": 3000, "differential_evolution": 3000, "dual_annealing": 3000,
    "dfo_ls": 1000,
}  # fmt: skip
"""Of methods that take a tenth of a millisecond and more for each; the others have 20,000."""

NEEDS = {"ngopt": "nevergrad", "dehb": "dehb", "dfo_ls": "dfols"}

EXPECTED_FAILURES = {
    "miho_reference": {
        "starts_at_the_common_start": "draws uniformly with noise, as the authors' code does",
        "stays_in_the_box": "clips at lower bounds only, as the authors' code does",
    },
}


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize(
    "path",
    [pytest.param(p, marks=[pytest.mark.slow] * (p.stem in SLOW), id=p.stem) for p in OPTIMIZERS],
)
def test_conformance(path: Path, check: str) -> None:
    if path.stem in NEEDS:
        pytest.importorskip(NEEDS[path.stem])
    node = OmegaConf.to_container(OmegaConf.load(path))
    optimizer = instantiate(node, "optimizer", Optimizer)
    evaluations = EVALUATIONS.get(path.stem, BUDGET)
    run_check(check, optimizer, EXPECTED_FAILURES.get(path.stem, {}), evaluations)
