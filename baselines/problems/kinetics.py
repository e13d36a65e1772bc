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


def _michaelis_menten_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    share = inputs[0] / (b[1] + inputs[0])
    return share, -b[0] * share / (b[1] + inputs[0])


def isomerization(inputs: Inputs, b: Theta) -> Any:
    """b1 b3 (x2 - x3 / 1.632) / (1 + b2 x1 + b3 x2 + b4 x3), of Hougen and Watson."""
    x1, x2, x3 = inputs
    return b[0] * b[2] * (x2 - x3 / EQUILIBRIUM) / (1 + b[1] * x1 + b[2] * x2 + b[3] * x3)


def _isomerization_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    x1, x2, x3 = inputs
    share = 1 / (1 + b[1] * x1 + b[2] * x2 + b[3] * x3)
    drive = (x2 - x3 / EQUILIBRIUM) * share
    slope = -b[0] * b[2] * drive * share
    return b[2] * drive, slope * x1, b[0] * drive + slope * x2, slope * x3


def two_decays(inputs: Inputs, b: Theta) -> Any:
    """b1 exp(-b2 x) + b3 exp(-b4 x): two compartments after an injection."""
    x = inputs[0]
    return b[0] * np.exp(-b[1] * x) + b[2] * np.exp(-b[3] * x)


def _two_decays_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    x = inputs[0]
    first, second = np.exp(-b[1] * x), np.exp(-b[3] * x)
    return first, -b[0] * x * first, second, -b[2] * x * second


def lubricant(inputs: Inputs, b: Theta) -> Any:
    """b1 / (b2 + x1) + b3 x2 + b4 x2^2 + b5 x2^3 + (b6 x2 + b7 x2^3) exp(-x1 / (b8 + b9 x2^2))."""
    T, p = inputs
    square = p * p
    fading = (b[5] + b[6] * square) * p * np.exp(-T / (b[7] + b[8] * square))
    return b[0] / (b[1] + T) + ((b[4] * p + b[3]) * p + b[2]) * p + fading


def _lubricant_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    T, p = inputs
    square, pressure = p * p, p * 1
    share, cooled = 1 / (b[1] + T), 1 / (b[7] + b[8] * square)
    faded = np.exp(-T * cooled) * p
    slope = (b[5] + b[6] * square) * faded * T * cooled * cooled
    return (
        share, -b[0] * share * share, pressure, square, square * p, faded, faded * square,
        slope, slope * square,
    )  # fmt: skip


def chloride(inputs: Inputs, b: Theta) -> Any:
    """b1 (1 - b2 exp(-b3 x))."""
    return b[0] * (1 - b[1] * np.exp(-b[2] * inputs[0]))


def _chloride_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    decay = np.exp(-b[2] * inputs[0])
    return 1 - b[1] * decay, -b[0] * decay, b[0] * b[1] * decay * inputs[0]


def tetracycline(inputs: Inputs, b: Theta) -> Any:
    """b3 (exp(-b1 (x - b4)) - exp(-b2 (x - b4))): a compartment that fills from another, late."""
    late = inputs[0] - b[3]
    return b[2] * (np.exp(-b[0] * late) - np.exp(-b[1] * late))


def _tetracycline_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    late = inputs[0] - b[3]
    out, into = np.exp(-b[0] * late), np.exp(-b[1] * late)
    return (
        -b[2] * late * out, b[2] * late * into, out - into, b[2] * (b[0] * out - b[1] * into)
    )  # fmt: skip


def first_order(inputs: Inputs, b: Theta) -> Any:
    """x1 b1 b2 / (b3 (b2 - b1)) (exp(-b1 x2) - exp(-b2 x2)): a dose x1, absorbed and eliminated."""
    dose, x = inputs
    return dose * (b[0] * b[1]) * (np.exp(-b[0] * x) - np.exp(-b[1] * x)) / (b[2] * (b[1] - b[0]))


def _first_order_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    dose, x = inputs
    out, into = np.exp(-b[0] * x), np.exp(-b[1] * x)
    size = dose / (b[2] * (b[1] - b[0]))
    value = size * (b[0] * b[1]) * (out - into)
    bend = value / (b[1] - b[0])
    by_out = size * b[1] * (out - into) - size * (b[0] * b[1]) * x * out + bend
    by_into = size * b[0] * (out - into) + size * (b[0] * b[1]) * x * into - bend
    return by_out, by_into, -value / b[2]


def gompertz(inputs: Inputs, b: Theta) -> Any:
    """b1 exp(-b2 b3^x)."""
    return b[0] * np.exp(-b[1] * np.exp(inputs[0] * np.log(b[2])))


def _gompertz_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    power = np.exp(inputs[0] * np.log(b[2]))
    grown = np.exp(-b[1] * power)
    slope = -b[0] * grown * power
    return grown, slope, slope * b[1] * inputs[0] / b[2]


FORMS = {
    "michaelis_menten": Form(michaelis_menten, _michaelis_menten_derivatives, 2, (1,)),
    "isomerization": Form(isomerization, _isomerization_derivatives, 4, (1,), inputs=3),
    "two_decays": Form(two_decays, _two_decays_derivatives, 4, (1, 3)),
    "lubricant": Form(lubricant, _lubricant_derivatives, 9, (1, 3, 4, 5, 6, 7), inputs=2),
    "chloride": Form(chloride, _chloride_derivatives, 3, (1,)),
    "tetracycline": Form(tetracycline, _tetracycline_derivatives, 4, (3,)),
    "first_order": Form(first_order, _first_order_derivatives, 3, inputs=2),
    "gompertz": Form(gompertz, _gompertz_derivatives, 3, (1,)),
}
