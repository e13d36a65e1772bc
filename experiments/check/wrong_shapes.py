"""How often a report says that a model has the wrong shape, for wrong models and drifting noise.

python -m experiments.check.wrong_shapes [--sets 200] [--rows 300]   # about ten minutes

Rows are measured in one sweep of x from 0 to 1, or in random order. `right` fits a line to a line.
The other models lack a term of `--size` standard deviations of the noise (root mean square after
the fit): a peak (of width 0.1), a curvature (a parabola), a saturation (from 0.7 on), or an offset
(a step in the middle). The noise is autoregressive of first order. A row of the table gives
percentages of datasets: errors follow x by the test for independent rows (`before`); the report
says that the model has the wrong shape (`wrong shape`; in one sweep it adds "or the measurement
drifts"), or that the data cannot distinguish this from drifting noise (`cannot tell`).
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
import pandas as pd
from tqdm import tqdm

from experiments.check import arguments
from experiments.check.coverage import autoregressive, linear_fit
from miho.identification import linearised
from miho.identification.validation import is_finding, residual_trends
from miho.optim.seeds import stream
from miho.quantities import Array

LACKING: Mapping[str, Callable[[Array], Array]] = MappingProxyType(
    {
        "right": np.zeros_like,
        "peak": lambda x: np.exp(-(((x - 0.6) / 0.1) ** 2)),
        "curvature": np.square,
        "saturation": lambda x: np.minimum(x, 0.7),
        "offset": lambda x: np.where(x > 0.5, 1.0, 0.0),
    }
)
CORRELATIONS = (0.0, 0.3, 0.5, 0.7, 0.9)
ORDERS = ("sweep", "random")


def verdicts(order: str, lacking: str, correlation: float, rows: int, size: float, n: int) -> Array:
    """Whether dataset `n` counts in each of the three columns of the table, (3,)."""
    rng = stream("wrong shapes", order, lacking, str(correlation), rows, n)
    x = np.arange(rows) / (rows - 1) if order == "sweep" else rng.uniform(0, 1, rows)
    X = np.stack([np.ones(rows), x], axis=1)
    missing = LACKING[lacking](x)
    missing = missing - X @ np.linalg.lstsq(X, missing, rcond=None)[0]
    missing *= size / max(float(np.sqrt(np.mean(missing**2))), 1e-9)
    noise = autoregressive(correlation, rows, rng)
    # The line is fitted exactly; the columns of the linear model are 1 and x, the second its first.
    problem, theta = linear_fit(X[:, ::-1], missing + noise)
    at = linearised(problem, theta, neighbours=True)
    (row, *_) = residual_trends(problem, theta, at).to_dict("records")
    before = is_finding(row["explained"], row["p of independent rows"])
    now = is_finding(row["explained"], row["p"])
    return np.array([before, now, before and not now])


def table(sets: int, rows: int, size: float) -> pd.DataFrame:
    """One row per order, model and correlation."""
    cases = [(o, m, c) for o in ORDERS for m in LACKING for c in CORRELATIONS]
    lines = []
    for order, lacking, correlation in tqdm(cases, disable=None):
        shares = np.mean(
            [verdicts(order, lacking, correlation, rows, size, n) for n in range(sets)], axis=0
        )
        named = zip(("before", "wrong shape", "cannot tell"), 100 * shares, strict=True)
        lines.append({"order": order, "lacks": lacking, "AR(1)": correlation, **dict(named)})
    return pd.DataFrame(lines)


def main() -> None:
    """Print the table."""
    options = arguments(__doc__, sets=200, rows=300, size=1.0)
    print(table(**vars(options)).to_string(index=False, float_format="%.1f"))


if __name__ == "__main__":
    main()
