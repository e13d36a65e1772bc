"""Whether an installed wheel has the machine of formulas, and fits the README's example with it."""

import sys

import numpy as np

import miho
from miho.core import machine

t = np.linspace(0, 2, 50)
y = 2 * np.exp(-1.5 * t) + 0.05 * np.random.default_rng(1).standard_normal(50)
fit = miho.fit(lambda t, a, b: a * np.exp(-b * t), t, y, {"a": (0, 5), "b": (0, 10)})
if machine() is None:
    sys.exit("the wheel has no machine of formulas")
if not np.allclose(fit.theta, (2.0196, 1.5239), rtol=1e-4):
    sys.exit(f"the parameters are {fit.theta}; expected 2.0196 and 1.5239")
