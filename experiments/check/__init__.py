"""Quantitative checks of methods, models and tables: `python -m experiments.check.NAME`.

aa                  the statistics of the arena find no difference between a method and itself
brake               round trips and parameters of the brake models, and a law from a driving log
coefficients        writes the constants of the elementary functions
coverage            coverage of 95 % intervals
engine              curves and map of the engine against the true one
ert                 expected running times against the values of iohinspector
false_ends          how often `miho_gn` agrees on a wrong optimum
gradient_descent    how steadily the loss falls in the paper's gradient descent
killed              evaluations that are lost if an expensive run is killed twenty times
mf61_lateral        27 coefficients of MF 6.1 from noisy samples
next_measurement    advised rows narrow intervals as much as the best random rows
nist                correct digits on NIST's problems, compared with SciPy and lmfit
optima              the best known optimum of each problem, computed again
printed_equations   both field tests with the printed and with the corrected equations
published_problems  writes conf/problem of the published problems by their rule
readings            the paper's comparison under each reading of its unspecified settings
residual_problems   writes conf/problem of two sets of least-squares problems
row_order           parameters that the first rows of an order determine
stated_coverage     coverage with ties, priors, sigma and several datasets
uneven_spread       coverage if the variance of the errors is not constant
wide_boxes          effect of very wide bounds
wrong_shapes        how often a report says that a model has the wrong shape

Checks that take only seconds are also tests, in tests/experiments/test_check.py.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path


def reference_data() -> Path:
    """Folder of third-party data: the first argument, else MIHO_DATA_DIR, else ../shared/data."""
    default = Path(__file__).parents[3] / "shared" / "data"
    return Path(sys.argv[1] if len(sys.argv) > 1 else os.environ.get("MIHO_DATA_DIR", default))
