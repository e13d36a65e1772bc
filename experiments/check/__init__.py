"""What methods, models and tables are worth, in figures: `python -m experiments.check.NAME`.

aa                  one method under two names is not told apart by the statistics of the arena
brake               round trips and parameters of the brake models, and a law from a driving log
coverage            how often 95 % intervals hold the truth
engine              curves and map of the engine against the true one
ert                 expected running times against those of iohinspector
false_ends          how often `miho_gn` agrees on a wrong optimum
gradient_descent    how steadily the paper's gradient descent falls
killed              what it costs to kill a dear run twenty times
mf61_lateral        27 coefficients of MF 6.1 from noisy samples
next_measurement    that advised rows narrow intervals as much as the best of random ones
nist                digits of parameters and standard errors on NIST's problems, beside others'
optima              the best known optimum of each problem, found anew
published_problems  writes conf/problem of the published problems by their rule
printed_equations   both field tests by the equations as printed and corrected
replay              whether stored runs are repeated to the last bit
row_order           what the first rows of an order determine
same_by_workers     whether a run is the same, whoever makes its evaluations
stated_coverage     the same as coverage, with ties, priors, sigma and several data sets

What takes seconds of it is a test as well, in tests/experiments/test_check.py.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path


def reference_data() -> Path:
    """Third-party data: the first argument, else MIHO_DATA_DIR, else ../shared/data."""
    default = Path(__file__).parents[3] / "shared" / "data"
    return Path(sys.argv[1] if len(sys.argv) > 1 else os.environ.get("MIHO_DATA_DIR", default))
