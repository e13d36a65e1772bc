"""Formulas of kinetics and growth in Bates and Watts (1988) and in R's `stats`.

Formulas of one and two compartments are solutions of their differential equations.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from baselines.problems.records import Form, Inputs, Theta

EQUILIBRIUM = 1.632
"""Equilibrium constant of n-pentane and isopentane at the temperature of the experiment."""


def michaelis_menten(inputs: Inputs, b: Theta) -> Any:
    """b1 x / (b2 + x)."""
    return b[0] * inputs[0] / (b[1] + inputs[0])


def isomerization(inputs: Inputs, b: Theta) -> Any:
    """b1 b3 (x2 - x3 / 1.632) / (1 + b2 x1 + b3 x2 + b4 x3), of Hougen and Watson."""
    x1, x2, x3 = inputs
    return b[0] * b[2] * (x2 - x3 / EQUILIBRIUM) / (1 + b[1] * x1 + b[2] * x2 + b[3] * x3)


def two_decays(inputs: Inputs, b: Theta) -> Any:
    """b1 exp(-b2 x) + b3 exp(-b4 x): two compartments after an injection."""
    x = inputs[0]
    return b[0] * np.exp(-b[1] * x) + b[2] * np.exp(-b[3] * x)


def lubricant(inputs: Inputs, b: Theta) -> Any:
    """b1 / (b2 + x1) + b3 x2 + b4 x2^2 + b5 x2^3 + (b6 x2 + b7 x2^3) exp(-x1 / (b8 + b9 x2^2))."""
    T, p = inputs
    square = p * p
    fading = (b[5] + b[6] * square) * p * np.exp(-T / (b[7] + b[8] * square))
    return b[0] / (b[1] + T) + ((b[4] * p + b[3]) * p + b[2]) * p + fading


def chloride(inputs: Inputs, b: Theta) -> Any:
    """b1 (1 - b2 exp(-b3 x))."""
    return b[0] * (1 - b[1] * np.exp(-b[2] * inputs[0]))


def tetracycline(inputs: Inputs, b: Theta) -> Any:
    """b3 (exp(-b1 (x - b4)) - exp(-b2 (x - b4))): a compartment that fills from another, late."""
    late = inputs[0] - b[3]
    return b[2] * (np.exp(-b[0] * late) - np.exp(-b[1] * late))


def first_order(inputs: Inputs, b: Theta) -> Any:
    """x1 b1 b2 / (b3 (b2 - b1)) (exp(-b1 x2) - exp(-b2 x2)): a dose x1, absorbed and eliminated."""
    dose, x = inputs
    return dose * (b[0] * b[1]) * (np.exp(-b[0] * x) - np.exp(-b[1] * x)) / (b[2] * (b[1] - b[0]))


def gompertz(inputs: Inputs, b: Theta) -> Any:
    """b1 exp(-b2 b3^x)."""
    return b[0] * np.exp(-b[1] * np.exp(inputs[0] * np.log(b[2])))


FORMS = {
    "michaelis_menten": Form(michaelis_menten, 2),
    "isomerization": Form(isomerization, 4, inputs=3),
    "two_decays": Form(two_decays, 4),
    "lubricant": Form(lubricant, 9, inputs=2),
    "chloride": Form(chloride, 3),
    "tetracycline": Form(tetracycline, 4),
    "first_order": Form(first_order, 3, inputs=2),
    "gompertz": Form(gompertz, 3),
}
