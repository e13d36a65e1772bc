"""Effect of very wide bounds: curves in boxes of 10 to 1e9 times the true values.

python -m experiments.check.wide_boxes --seeds 20

The bounds of each parameter are 0 and a multiple of its true value. The bounds of the tire's
curvature E are plus and minus that multiple; in a second set of boxes the upper one is 1, as for
real tires. A run is right if its loss is at most 1e-4 above the loss after a descent from the true
parameters; it claims an optimum if it ends by evidence.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from experiments.benchmarks.bars import machine
from experiments.check import arguments
from experiments.check.coverage import magic_formula
from experiments.check.families import drawn
from miho import MIHOGN, Budget, CurveFit, minimize
from miho.quantities import Array
from miho.study import single_thread

TIMES = 10.0, 1e3, 1e6, 1e9
RIGHT = 1e-4


class Curve(NamedTuple):
    """A formula of x and parameters, their true values, the measured x, and the noise.

    Parameters named in `signed` have bounds on both sides of zero, the upper one at most `highest`.
    """

    formula: Callable[..., Array]
    true: tuple[float, ...]
    x: Array
    noise: float
    signed: str = ""
    highest: float = np.inf

    def fit(self, times: float) -> CurveFit:
        """Problem in a box of `times` the true values."""
        names = self.formula.__code__.co_varnames[1 : 1 + len(self.true)]
        box = []
        for name, value in zip(names, self.true, strict=True):
            high, signed = times * abs(value), name in self.signed
            box.append((-high * signed, min(high, self.highest) if signed else high))
        rng = np.random.default_rng(5)
        return drawn(self.formula, [self.x], self.true, self.noise, box, rng)

    def best(self, fit: CurveFit) -> float:
        """Loss at the end of a descent from the true parameters."""
        true = np.array(self.true, dtype=float)
        descent = least_squares(fit.residuals, true, x_scale=np.abs(true), ftol=1e-12, xtol=1e-12)
        return 2 * float(descent.cost) / self.x.size


CURVES = {
    "decay": Curve(lambda x, a, b: a * np.exp(-b * x), (2.5, 1.3), np.linspace(0, 4, 50), 0.05),
    "tire": Curve(magic_formula, (10, 1.5, 1, -0.5), np.linspace(-0.3, 0.3, 100), 0.03, "E"),
    "tire, E <= 1": Curve(
        magic_formula, (10, 1.5, 1, -0.5), np.linspace(-0.3, 0.3, 100), 0.03, "E", 1.0
    ),
    "peak": Curve(
        lambda x, a, c, w: a * np.exp(-(((x - c) / w) ** 2)), (3, 5, 1.2), np.linspace(0, 10, 80),
        0.1,
    ),
    "logistic": Curve(
        lambda x, a, r, t: a / (1 + np.exp(-r * (x - t))), (4, 0.9, 5), np.linspace(0, 10, 60), 0.1
    ),
}  # fmt: skip


def main() -> None:
    """Fit, print."""
    seeds = arguments(__doc__, seeds=20).seeds
    print(machine())
    for name, curve in CURVES.items():
        for times in TIMES:
            fit, budget = curve.fit(times), Budget(evaluations=30_000)
            with single_thread():
                runs = [minimize(MIHOGN(), fit, budget, seed) for seed in range(seeds)]
            best = curve.best(fit)
            right = [run.loss <= (1 + RIGHT) * best for run in runs]
            claims = [str(run.outcome) == "converged" for run in runs]
            wrong = sum(c and not r for c, r in zip(claims, right, strict=True))
            spent = np.median([run.evaluations for run in runs])
            print(
                f"{name:12s} {times:6.0e} times: {sum(right)} of {seeds} right, "
                f"{sum(claims)} claims, {wrong} wrong, {spent:.0f} evaluations",
                flush=True,
            )


if __name__ == "__main__":
    main()
