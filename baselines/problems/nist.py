"""Formulas of NIST's StRD for nonlinear regression, as published.

The parameters are b1, b2, ... in the order of the tuple.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from baselines.problems.records import Form, Inputs, Theta

YEAR = 2 * math.pi / 12
CIRCLE = 2 * math.pi


def bennett5(inputs: Inputs, b: Theta) -> Any:
    """b1 (b2 + x)^(-1/b3)."""
    return b[0] * np.exp(-np.log(b[1] + inputs[0]) / b[2])


def rise(inputs: Inputs, b: Theta) -> Any:
    """b1 (1 - exp(-b2 x))."""
    return b[0] * (1 - np.exp(-b[1] * inputs[0]))


def chwirut(inputs: Inputs, b: Theta) -> Any:
    """exp(-b1 x) / (b2 + b3 x)."""
    return np.exp(-b[0] * inputs[0]) / (b[1] + b[2] * inputs[0])


def power(inputs: Inputs, b: Theta) -> Any:
    """b1 x^b2, for x above 0."""
    return b[0] * np.exp(b[1] * np.log(inputs[0]))


def enso(inputs: Inputs, b: Theta) -> Any:
    """b1 and cosines and sines of a period of 12 (b2, b3), b4 (b5, b6) and b7 (b8, b9)."""
    x = inputs[0]
    year, first, second = YEAR * x, CIRCLE * x / b[3], CIRCLE * x / b[6]
    cycles = (
        b[4] * np.cos(first) + b[5] * np.sin(first) + b[7] * np.cos(second) + b[8] * np.sin(second)
    )
    return b[0] + b[1] * np.cos(year) + b[2] * np.sin(year) + cycles


def eckerle4(inputs: Inputs, b: Theta) -> Any:
    """b1 / b2 exp(-((x - b3) / b2)^2 / 2)."""
    z = (inputs[0] - b[2]) / b[1]
    return b[0] * np.exp(-0.5 * z * z) / b[1]


def two_peaks(inputs: Inputs, b: Theta) -> Any:
    """b1 exp(-b2 x) and two peaks, b3 exp(-((x - b4) / b5)^2) and that of b6, b7 and b8."""
    x = inputs[0]
    z, w = (x - b[3]) / b[4], (x - b[6]) / b[7]
    return b[0] * np.exp(-b[1] * x) + b[2] * np.exp(-z * z) + b[5] * np.exp(-w * w)


def cubic_over_cubic(inputs: Inputs, b: Theta) -> Any:
    """(b1 + b2 x + b3 x^2 + b4 x^3) / (1 + b5 x + b6 x^2 + b7 x^3)."""
    x = inputs[0]
    above = ((b[3] * x + b[2]) * x + b[1]) * x + b[0]
    return above / (((b[6] * x + b[5]) * x + b[4]) * x + 1)


def quadratic_over_quadratic(inputs: Inputs, b: Theta) -> Any:
    """(b1 + b2 x + b3 x^2) / (1 + b4 x + b5 x^2)."""
    x = inputs[0]
    return ((b[2] * x + b[1]) * x + b[0]) / ((b[4] * x + b[3]) * x + 1)


def three_decays(inputs: Inputs, b: Theta) -> Any:
    """b1 exp(-b2 x) + b3 exp(-b4 x) + b5 exp(-b6 x)."""
    x = inputs[0]
    return b[0] * np.exp(-b[1] * x) + b[2] * np.exp(-b[3] * x) + b[4] * np.exp(-b[5] * x)


def kowalik_osborne(inputs: Inputs, b: Theta) -> Any:
    """b1 (x^2 + b2 x) / (x^2 + b3 x + b4)."""
    x = inputs[0]
    return b[0] * (x * x + b[1] * x) / (x * x + b[2] * x + b[3])


def meyer(inputs: Inputs, b: Theta) -> Any:
    """b1 exp(b2 / (x + b3))."""
    return b[0] * np.exp(b[1] / (inputs[0] + b[2]))


def osborne_1(inputs: Inputs, b: Theta) -> Any:
    """b1 + b2 exp(-b4 x) + b3 exp(-b5 x)."""
    x = inputs[0]
    return b[0] + b[1] * np.exp(-b[3] * x) + b[2] * np.exp(-b[4] * x)


def misra1b(inputs: Inputs, b: Theta) -> Any:
    """b1 (1 - (1 + b2 x / 2)^-2)."""
    share = 1 / (1 + b[1] * inputs[0] / 2)
    return b[0] * (1 - share * share)


def misra1c(inputs: Inputs, b: Theta) -> Any:
    """b1 (1 - (1 + 2 b2 x)^-0.5)."""
    return b[0] * (1 - 1 / np.sqrt(1 + 2 * b[1] * inputs[0]))


def saturation(inputs: Inputs, b: Theta) -> Any:
    """b1 b2 x / (1 + b2 x)."""
    z = b[1] * inputs[0]
    return b[0] * z / (1 + z)


def nelson(inputs: Inputs, b: Theta) -> Any:
    """b1 - b2 x1 exp(-b3 x2)."""
    return b[0] - b[1] * inputs[0] * np.exp(-b[2] * inputs[1])


def logistic(inputs: Inputs, b: Theta) -> Any:
    """b1 / (1 + exp(b2 - b3 x))."""
    return b[0] / (1 + np.exp(b[1] - b[2] * inputs[0]))


def richards(inputs: Inputs, b: Theta) -> Any:
    """b1 / (1 + exp(b2 - b3 x))^(1/b4)."""
    return b[0] * np.exp(-np.log(1 + np.exp(b[1] - b[2] * inputs[0])) / b[3])


def roszman1(inputs: Inputs, b: Theta) -> Any:
    """b1 - b2 x - arctan(b3 / (x - b4)) / pi."""
    x = inputs[0]
    return b[0] - b[1] * x - np.arctan(b[2] / (x - b[3])) / math.pi


FORMS = {
    "bennett5": Form(bennett5, 3),
    "rise": Form(rise, 2),
    "chwirut": Form(chwirut, 3),
    "power": Form(power, 2),
    "enso": Form(enso, 9),
    "eckerle4": Form(eckerle4, 3),
    "two_peaks": Form(two_peaks, 8),
    "cubic_over_cubic": Form(cubic_over_cubic, 7),
    "quadratic_over_quadratic": Form(quadratic_over_quadratic, 5),
    "three_decays": Form(three_decays, 6),
    "kowalik_osborne": Form(kowalik_osborne, 4),
    "meyer": Form(meyer, 3),
    "osborne_1": Form(osborne_1, 5),
    "misra1b": Form(misra1b, 2),
    "misra1c": Form(misra1c, 2),
    "saturation": Form(saturation, 2),
    "nelson": Form(nelson, 3, inputs=2),
    "logistic": Form(logistic, 3),
    "richards": Form(richards, 4),
    "roszman1": Form(roszman1, 4),
}
