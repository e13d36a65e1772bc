"""Quantitative checks of methods, models and tables: `python -m experiments.check.NAME`.

coefficients        writes the constants of the elementary functions
coverage            coverage of 95 % intervals
false_ends          how often `miho_gn` agrees on a wrong optimum
next_measurement    advised rows narrow intervals as much as the best random rows
nist                correct digits on NIST's problems, compared with SciPy and lmfit
optima              the best known optimum of each problem, computed again
printed_equations   both field tests with the printed and with the corrected equations
readings            the paper's comparison under each reading of its unspecified settings
stated_coverage     coverage with ties, priors, sigma and several datasets
uneven_spread       coverage if the variance of the errors is not constant
wide_boxes          effect of very wide bounds
wrong_shapes        how often a report says that a model has the wrong shape

Checks that take only seconds are also tests, in tests/experiments/test_check.py.
"""

from argparse import ArgumentParser, Namespace


def arguments(doc: str | None, **defaults: float) -> Namespace:
    """Read the options of a check, which are numbers with `defaults`, from the command line.

    The first line of its docstring `doc` is the description.
    """
    parser = ArgumentParser(description=(doc or "").partition("\n")[0])
    for name, default in defaults.items():
        help_text = f"(default: {default})"
        parser.add_argument(f"--{name}", type=type(default), default=default, help=help_text)
    return parser.parse_args()
