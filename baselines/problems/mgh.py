"""Data-fitting formulas of More, Garbow and Hillstrom (1981) and de Villiers and Glasser."""

from __future__ import annotations

from typing import Any

import numpy as np

from baselines.problems.records import Form, Inputs, Theta


def bard(inputs: Inputs, b: Theta) -> Any:
    """b1 + x / (b2 v + b3 w), where v = 16 - x and w is the lesser of x and v."""
    v = 16.0 - inputs[0]
    return b[0] + inputs[0] / (b[1] * v + b[2] * np.minimum(inputs[0], v))


def osborne_2(inputs: Inputs, b: Theta) -> Any:
    """b1 exp(-b5 x) and peaks b2 exp(-b6 (x - b9)^2), of b3, b7 and b10, and of b4, b8 and b11."""
    x = inputs[0]
    first, second, third = x - b[8], x - b[9], x - b[10]
    peaks = b[1] * np.exp(-b[5] * first * first) + b[2] * np.exp(-b[6] * second * second)
    return b[0] * np.exp(-b[4] * x) + peaks + b[3] * np.exp(-b[7] * third * third)


def jennrich_sampson(inputs: Inputs, b: Theta) -> Any:
    """exp(b1 x) + exp(b2 x)."""
    return np.exp(b[0] * inputs[0]) + np.exp(b[1] * inputs[0])


def gulf(inputs: Inputs, b: Theta) -> Any:
    """exp(-|x - b2|^b3 / b1)."""
    run = inputs[0] - b[1]
    return np.exp(-np.exp(b[2] * np.log(np.sqrt(run * run))) / b[0])


def glasser_1(inputs: Inputs, b: Theta) -> Any:
    """b1 b2^x sin(b3 x + b4)."""
    x = inputs[0]
    return b[0] * np.exp(x * np.log(b[1])) * np.sin(b[2] * x + b[3])


def glasser_2(inputs: Inputs, b: Theta) -> Any:
    """b1 b2^x tanh(b3 x + sin(b4 x)) cos(x exp(b5))."""
    x = inputs[0]
    rise = np.tanh(b[2] * x + np.sin(b[3] * x))
    return b[0] * np.exp(x * np.log(b[1])) * rise * np.cos(x * np.exp(b[4]))


FORMS = {
    "bard": Form(bard, 3),
    "osborne_2": Form(osborne_2, 11),
    "jennrich_sampson": Form(jennrich_sampson, 2),
    "gulf": Form(gulf, 3),
    "glasser_1": Form(glasser_1, 4),
    "glasser_2": Form(glasser_2, 5),
}
