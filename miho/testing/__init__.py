"""Conformance suite for optimizers, and a check of models.

    from miho.testing import check_optimizer
    check_optimizer(MyMethod())

runs all checks; to get one test per check, parametrise over `CHECKS`. A method that cannot pass a
check by design declares it with a reason: `expected_failures={"stays_in_the_box": "clips lower
bounds only"}`. A declared failure that passes is an error too, so that declarations stay true. A
method that takes milliseconds per evaluation may be checked with fewer evaluations:
`evaluations=300`. A method that computes for `PATIENCE` seconds of CPU time without an evaluation,
or waits for as many seconds, fails the check; this requires the main thread and a POSIX system.
"""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from miho.testing.decay_fit import PATIENCE, DecayFit, NoEvaluation
    from miho.testing.models import ConformanceError, check_model
    from miho.testing.optimizers import BUDGET, CHECKS, check_optimizer, run_check

__all__ = [
    "BUDGET", "CHECKS", "PATIENCE", "ConformanceError", "DecayFit", "NoEvaluation", "check_model",
    "check_optimizer", "run_check",
]  # fmt: skip

__getattr__, __dir__ = at_first_use(__name__)
