"""Every optimizer of conf/optimizer passes the conformance suite."""

from pathlib import Path

import pytest
from omegaconf import OmegaConf

from experiments.build import instantiate
from miho.optim import Optimizer
from miho.testing import CHECKS, run_check

OPTIMIZERS = sorted((Path(__file__).parent.parent / "conf" / "optimizer").glob("*.yaml"))

SLOW = {"optuna_hyperband", "gbo_large"}
"""Methods that take seconds a check, or differ from another in a setting alone."""

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
    node = OmegaConf.to_container(OmegaConf.load(path))
    assert node.pop("name") == path.stem
    optimizer = instantiate(node, "optimizer", Optimizer)
    run_check(check, optimizer, EXPECTED_FAILURES.get(path.stem, {}))
