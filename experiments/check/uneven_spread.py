"""Coverage of 95 % intervals if the variance of the errors is not constant.

python -m experiments.check.uneven_spread [--sets 500]   # about two minutes

Each dataset is a decay (a, b) or a line (a, b) with normal noise: `even`; a tenth of the `curve`;
proportional to `time`; or, for a line, larger at the `ends` or in the `middle`. The decay is
searched by a descent from the truth. A row of the table is a case with a number of rows: the
coverage of a and b by the linearised interval and by the sandwich (HC3), and the share of datasets
for which a report notes uneven errors.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from tqdm import tqdm

from experiments.check import arguments
from experiments.check.coverage import linear_fit
from miho import Dataset, Parameter, Space
from miho.identification import CurveFit, linearised
from miho.identification.flags import spread_is_uneven
from miho.identification.refit import refit
from miho.models import FunctionModel
from miho.optim.seeds import stream
from miho.quantities import Array

TRUTH = np.array([2.0, 1.5])
LENGTHS = (20, 40, 200)
SPACE = Space((Parameter("a", "-", 0.0, 9.0), Parameter("b", "-", 0.0, 9.0)))
DECAYS = ("even", "curve", "time")
LINES: Mapping[str, Callable[[Array], Array]] = MappingProxyType(
    {"ends": lambda x: np.abs(x) ** 2, "middle": lambda x: 1 - np.abs(x)}
)


def decay(t: Array, a: float, b: float) -> Array:
    """A decay."""
    return a * np.exp(-b * t)


def decay_fit(case: str, rows: int, rng: np.random.Generator) -> tuple[CurveFit, Array]:
    """The fit of a decay and the optimum."""
    t = np.linspace(0, 2, rows)
    curve = decay(t, 2.0, 1.5)
    deviation = {"even": 0.05 + 0 * t, "curve": 0.1 * curve, "time": 0.05 * t}[case]
    y = curve + deviation * rng.standard_normal(rows)
    data = Dataset("decay", {"t": t, "y": y}, {"t": "-", "y": "-"}, "y")
    problem = CurveFit(FunctionModel(decay, columns=("t",)), data, SPACE, compiled=False)
    return problem, refit(problem, TRUTH).theta


def line_fit(case: str, rows: int, rng: np.random.Generator) -> tuple[CurveFit, Array]:
    """The fit of a line, whose true parameters are 0, and the optimum."""
    x = np.linspace(-1, 1, rows)
    return linear_fit(np.stack([np.ones(rows), x], 1), LINES[case](x) * rng.standard_normal(rows))


def coverage(case: str, rows: int, sets: int) -> dict[str, object]:
    """A row of the table."""
    hits: dict[str, list[NDArray[np.bool_]]] = {"linearised": [], "sandwich": []}
    noted = 0
    for number in range(sets):
        rng = stream("uneven spread", case, rows, number)
        problem, theta = (line_fit if case in LINES else decay_fit)(case, rows, rng)
        off = np.abs(theta - (0.0 if case in LINES else TRUTH))
        at = linearised(problem, theta)
        for kind, covariance in (("linearised", at.covariance), ("sandwich", at.sandwich)):
            hits[kind].append(off <= at.quantile() * np.sqrt(np.diag(covariance)))
        noted += spread_is_uneven(problem, at, at)
    row: dict[str, object] = {"spread": case, "rows": rows}
    for kind, inside in hits.items():
        a, b = 100 * np.mean(inside, axis=0)
        row |= {f"{kind} a": f"{a:.1f} %", f"{kind} b": f"{b:.1f} %"}
    return {**row, "noted": f"{100 * noted / sets:.1f} %"}


def main() -> None:
    """Print the table."""
    sets = arguments(__doc__, sets=500).sets
    cases = [(case, rows) for case in (*DECAYS, *LINES) for rows in LENGTHS]
    rows = [coverage(*case, sets) for case in tqdm(cases, disable=None)]
    print(pd.DataFrame(rows).to_string(index=False))


if __name__ == "__main__":
    main()
