"""Formulas of NIST's StRD for nonlinear regression: values and derivatives, as published.

The parameters are b1, b2, ... in the order of the tuple. The numerator of a division by a
parameter is an array, so that division by zero gives infinity and no error.
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


def _bennett5_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    base = b[1] + inputs[0]
    log = np.log(base)
    power = np.exp(-log / b[2])
    return power, -b[0] * power / (b[2] * base), b[0] * power * (log / b[2] / b[2])


def rise(inputs: Inputs, b: Theta) -> Any:
    """b1 (1 - exp(-b2 x))."""
    return b[0] * (1 - np.exp(-b[1] * inputs[0]))


def _rise_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    decay = np.exp(-b[1] * inputs[0])
    return 1 - decay, b[0] * inputs[0] * decay


def chwirut(inputs: Inputs, b: Theta) -> Any:
    """exp(-b1 x) / (b2 + b3 x)."""
    return np.exp(-b[0] * inputs[0]) / (b[1] + b[2] * inputs[0])


def _chwirut_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    x = inputs[0]
    below = b[1] + b[2] * x
    value = np.exp(-b[0] * x) / below
    slope = -value / below
    return -x * value, slope, slope * x


def power(inputs: Inputs, b: Theta) -> Any:
    """b1 x^b2, for x above 0."""
    return b[0] * np.exp(b[1] * np.log(inputs[0]))


def _power_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    log = np.log(inputs[0])
    raised = np.exp(b[1] * log)
    return raised, b[0] * raised * log


def enso(inputs: Inputs, b: Theta) -> Any:
    """b1 and cosines and sines of a period of 12 (b2, b3), b4 (b5, b6) and b7 (b8, b9)."""
    x = inputs[0]
    year, first, second = YEAR * x, CIRCLE * x / b[3], CIRCLE * x / b[6]
    cycles = (
        b[4] * np.cos(first) + b[5] * np.sin(first) + b[7] * np.cos(second) + b[8] * np.sin(second)
    )
    return b[0] + b[1] * np.cos(year) + b[2] * np.sin(year) + cycles


def _enso_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    x = inputs[0]
    year, first, second = YEAR * x, CIRCLE * x / b[3], CIRCLE * x / b[6]
    c, s, C, S = np.cos(first), np.sin(first), np.cos(second), np.sin(second)
    by_first = (b[4] * s - b[5] * c) * first / b[3]
    by_second = (b[7] * S - b[8] * C) * second / b[6]
    return x * 0 + 1, np.cos(year), np.sin(year), by_first, c, s, by_second, C, S


def eckerle4(inputs: Inputs, b: Theta) -> Any:
    """b1 / b2 exp(-((x - b3) / b2)^2 / 2)."""
    z = (inputs[0] - b[2]) / b[1]
    return b[0] * np.exp(-0.5 * z * z) / b[1]


def _eckerle4_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    z = (inputs[0] - b[2]) / b[1]
    peak = np.exp(-0.5 * z * z) / b[1]
    slope = b[0] * peak / b[1]
    return peak, slope * (z * z - 1), slope * z


def two_peaks(inputs: Inputs, b: Theta) -> Any:
    """b1 exp(-b2 x) and two peaks, b3 exp(-((x - b4) / b5)^2) and that of b6, b7 and b8."""
    x = inputs[0]
    z, w = (x - b[3]) / b[4], (x - b[6]) / b[7]
    return b[0] * np.exp(-b[1] * x) + b[2] * np.exp(-z * z) + b[5] * np.exp(-w * w)


def _two_peaks_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    x = inputs[0]
    z, w = (x - b[3]) / b[4], (x - b[6]) / b[7]
    decay, first, second = np.exp(-b[1] * x), np.exp(-z * z), np.exp(-w * w)
    by_z, by_w = 2 * b[2] * first * z / b[4], 2 * b[5] * second * w / b[7]
    return decay, -b[0] * x * decay, first, by_z, by_z * z, second, by_w, by_w * w


def cubic_over_cubic(inputs: Inputs, b: Theta) -> Any:
    """(b1 + b2 x + b3 x^2 + b4 x^3) / (1 + b5 x + b6 x^2 + b7 x^3)."""
    x = inputs[0]
    above = ((b[3] * x + b[2]) * x + b[1]) * x + b[0]
    return above / (((b[6] * x + b[5]) * x + b[4]) * x + 1)


def _cubic_over_cubic_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    x = inputs[0]
    above = ((b[3] * x + b[2]) * x + b[1]) * x + b[0]
    share = 1 / (((b[6] * x + b[5]) * x + b[4]) * x + 1)
    slope = -above * share * share * x
    return (
        share, share * x, share * x * x, share * x * x * x, slope, slope * x, slope * x * x
    )  # fmt: skip


def quadratic_over_quadratic(inputs: Inputs, b: Theta) -> Any:
    """(b1 + b2 x + b3 x^2) / (1 + b4 x + b5 x^2)."""
    x = inputs[0]
    return ((b[2] * x + b[1]) * x + b[0]) / ((b[4] * x + b[3]) * x + 1)


def _quadratic_over_quadratic_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    x = inputs[0]
    share = 1 / ((b[4] * x + b[3]) * x + 1)
    slope = -((b[2] * x + b[1]) * x + b[0]) * share * share * x
    return share, share * x, share * x * x, slope, slope * x


def three_decays(inputs: Inputs, b: Theta) -> Any:
    """b1 exp(-b2 x) + b3 exp(-b4 x) + b5 exp(-b6 x)."""
    x = inputs[0]
    return b[0] * np.exp(-b[1] * x) + b[2] * np.exp(-b[3] * x) + b[4] * np.exp(-b[5] * x)


def _three_decays_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    x = inputs[0]
    first, second, third = np.exp(-b[1] * x), np.exp(-b[3] * x), np.exp(-b[5] * x)
    return first, -b[0] * x * first, second, -b[2] * x * second, third, -b[4] * x * third


def kowalik_osborne(inputs: Inputs, b: Theta) -> Any:
    """b1 (x^2 + b2 x) / (x^2 + b3 x + b4)."""
    x = inputs[0]
    return b[0] * (x * x + b[1] * x) / (x * x + b[2] * x + b[3])


def _kowalik_osborne_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    x = inputs[0]
    share = 1 / (x * x + b[2] * x + b[3])
    ratio = (x * x + b[1] * x) * share
    slope = -b[0] * ratio * share
    return ratio, b[0] * x * share, slope * x, slope


def meyer(inputs: Inputs, b: Theta) -> Any:
    """b1 exp(b2 / (x + b3))."""
    return b[0] * np.exp(b[1] / (inputs[0] + b[2]))


def _meyer_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    share = 1 / (inputs[0] + b[2])
    grown = np.exp(b[1] * share)
    slope = b[0] * grown * share
    return grown, slope, -slope * b[1] * share


def osborne_1(inputs: Inputs, b: Theta) -> Any:
    """b1 + b2 exp(-b4 x) + b3 exp(-b5 x)."""
    x = inputs[0]
    return b[0] + b[1] * np.exp(-b[3] * x) + b[2] * np.exp(-b[4] * x)


def _osborne_1_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    x = inputs[0]
    first, second = np.exp(-b[3] * x), np.exp(-b[4] * x)
    return x * 0 + 1, first, second, -b[1] * x * first, -b[2] * x * second


def misra1b(inputs: Inputs, b: Theta) -> Any:
    """b1 (1 - (1 + b2 x / 2)^-2)."""
    share = 1 / (1 + b[1] * inputs[0] / 2)
    return b[0] * (1 - share * share)


def _misra1b_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    share = 1 / (1 + b[1] * inputs[0] / 2)
    return 1 - share * share, b[0] * inputs[0] * share * share * share


def misra1c(inputs: Inputs, b: Theta) -> Any:
    """b1 (1 - (1 + 2 b2 x)^-0.5)."""
    return b[0] * (1 - 1 / np.sqrt(1 + 2 * b[1] * inputs[0]))


def _misra1c_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    square = 1 / (1 + 2 * b[1] * inputs[0])
    share = np.sqrt(square)
    return 1 - share, b[0] * inputs[0] * square * share


def saturation(inputs: Inputs, b: Theta) -> Any:
    """b1 b2 x / (1 + b2 x)."""
    z = b[1] * inputs[0]
    return b[0] * z / (1 + z)


def _saturation_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    z = b[1] * inputs[0]
    share = 1 / (1 + z)
    return z * share, b[0] * inputs[0] * share * share


def nelson(inputs: Inputs, b: Theta) -> Any:
    """b1 - b2 x1 exp(-b3 x2)."""
    return b[0] - b[1] * inputs[0] * np.exp(-b[2] * inputs[1])


def _nelson_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    ageing = inputs[0] * np.exp(-b[2] * inputs[1])
    return ageing * 0 + 1, -ageing, b[1] * ageing * inputs[1]


def logistic(inputs: Inputs, b: Theta) -> Any:
    """b1 / (1 + exp(b2 - b3 x))."""
    return b[0] / (1 + np.exp(b[1] - b[2] * inputs[0]))


def _logistic_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    share = 1 / (1 + np.exp(b[1] - b[2] * inputs[0]))
    slope = b[0] * share * (1 - share)
    return share, -slope, slope * inputs[0]


def richards(inputs: Inputs, b: Theta) -> Any:
    """b1 / (1 + exp(b2 - b3 x))^(1/b4)."""
    return b[0] * np.exp(-np.log(1 + np.exp(b[1] - b[2] * inputs[0])) / b[3])


def _richards_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    base = 1 + np.exp(b[1] - b[2] * inputs[0])
    log = np.log(base)
    grown = np.exp(-log / b[3])
    slope = b[0] * grown * (1 - 1 / base) / b[3]
    return grown, -slope, slope * inputs[0], b[0] * grown * (log / b[3] / b[3])


def roszman1(inputs: Inputs, b: Theta) -> Any:
    """b1 - b2 x - arctan(b3 / (x - b4)) / pi."""
    x = inputs[0]
    return b[0] - b[1] * x - np.arctan(b[2] / (x - b[3])) / math.pi


def _roszman1_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    x = inputs[0]
    run = x - b[3]
    share = 1 / (run * run + b[2] * b[2]) / math.pi
    return x * 0 + 1, -x, -run * share, -b[2] * share


FORMS = {
    "bennett5": Form(bennett5, _bennett5_derivatives, 3, (1,)),
    "rise": Form(rise, _rise_derivatives, 2, (1,)),
    "chwirut": Form(chwirut, _chwirut_derivatives, 3),
    "power": Form(power, _power_derivatives, 2, (1,)),
    "enso": Form(enso, _enso_derivatives, 9, (1, 2, 3, 5, 6, 8, 9)),
    "eckerle4": Form(eckerle4, _eckerle4_derivatives, 3, (1,)),
    "two_peaks": Form(two_peaks, _two_peaks_derivatives, 8, (1, 3, 6)),
    "cubic_over_cubic": Form(cubic_over_cubic, _cubic_over_cubic_derivatives, 7, (1, 2, 3, 4)),
    "quadratic_over_quadratic": Form(
        quadratic_over_quadratic, _quadratic_over_quadratic_derivatives, 5, (1, 2, 3),
    ),
    "three_decays": Form(three_decays, _three_decays_derivatives, 6, (1, 3, 5)),
    "kowalik_osborne": Form(kowalik_osborne, _kowalik_osborne_derivatives, 4, (1,)),
    "meyer": Form(meyer, _meyer_derivatives, 3, (1,)),
    "osborne_1": Form(osborne_1, _osborne_1_derivatives, 5, (1, 2, 3)),
    "misra1b": Form(misra1b, _misra1b_derivatives, 2, (1,)),
    "misra1c": Form(misra1c, _misra1c_derivatives, 2, (1,)),
    "saturation": Form(saturation, _saturation_derivatives, 2, (1,)),
    "nelson": Form(nelson, _nelson_derivatives, 3, (1, 2), inputs=2),
    "logistic": Form(logistic, _logistic_derivatives, 3, (1,)),
    "richards": Form(richards, _richards_derivatives, 4, (1,)),
    "roszman1": Form(roszman1, _roszman1_derivatives, 4, (1, 2)),
}  # fmt: skip
