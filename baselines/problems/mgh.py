"""Data-fitting formulas of More, Garbow and Hillstrom (1981) and de Villiers and Glasser."""

from __future__ import annotations

from typing import Any

import numpy as np

from baselines.problems.records import Form, Inputs, Theta


def bard(inputs: Inputs, b: Theta) -> Any:
    """b1 + x / (b2 v + b3 w), where v = 16 - x and w is the lesser of x and v."""
    v = 16.0 - inputs[0]
    return b[0] + inputs[0] / (b[1] * v + b[2] * np.minimum(inputs[0], v))


def _bard_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    x = inputs[0]
    v = 16.0 - x
    w = np.minimum(x, v)
    share = 1 / (b[1] * v + b[2] * w)
    slope = -x * share * share
    return x * 0 + 1, slope * v, slope * w


def osborne_2(inputs: Inputs, b: Theta) -> Any:
    """b1 exp(-b5 x) and peaks b2 exp(-b6 (x - b9)^2), of b3, b7 and b10, and of b4, b8 and b11."""
    x = inputs[0]
    first, second, third = x - b[8], x - b[9], x - b[10]
    peaks = b[1] * np.exp(-b[5] * first * first) + b[2] * np.exp(-b[6] * second * second)
    return b[0] * np.exp(-b[4] * x) + peaks + b[3] * np.exp(-b[7] * third * third)


def _osborne_2_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    x = inputs[0]
    r, s, t = x - b[8], x - b[9], x - b[10]
    decay = np.exp(-b[4] * x)
    first, second, third = np.exp(-b[5] * r * r), np.exp(-b[6] * s * s), np.exp(-b[7] * t * t)
    u, v, w = b[1] * first * r, b[2] * second * s, b[3] * third * t
    return (
        decay, first, second, third, -b[0] * x * decay, -u * r, -v * s, -w * t,
        2 * b[5] * u, 2 * b[6] * v, 2 * b[7] * w,
    )  # fmt: skip


def jennrich_sampson(inputs: Inputs, b: Theta) -> Any:
    """exp(b1 x) + exp(b2 x)."""
    return np.exp(b[0] * inputs[0]) + np.exp(b[1] * inputs[0])


def _jennrich_sampson_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    x = inputs[0]
    return x * np.exp(b[0] * x), x * np.exp(b[1] * x)


def gulf(inputs: Inputs, b: Theta) -> Any:
    """exp(-|x - b2|^b3 / b1)."""
    run = inputs[0] - b[1]
    return np.exp(-np.exp(b[2] * np.log(np.sqrt(run * run))) / b[0])


def _gulf_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    run = inputs[0] - b[1]
    log = np.log(np.sqrt(run * run))
    power = np.exp(b[2] * log) / b[0]
    slope = np.exp(-power) * power
    return slope / b[0], slope * b[2] / run, -slope * log


def glasser_1(inputs: Inputs, b: Theta) -> Any:
    """b1 b2^x sin(b3 x + b4)."""
    x = inputs[0]
    return b[0] * np.exp(x * np.log(b[1])) * np.sin(b[2] * x + b[3])


def _glasser_1_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    x = inputs[0]
    grown = np.exp(x * np.log(b[1]))
    wave, slope = grown * np.sin(b[2] * x + b[3]), b[0] * grown * np.cos(b[2] * x + b[3])
    return wave, b[0] * wave * x / b[1], slope * x, slope


def glasser_2(inputs: Inputs, b: Theta) -> Any:
    """b1 b2^x tanh(b3 x + sin(b4 x)) cos(x exp(b5))."""
    x = inputs[0]
    rise = np.tanh(b[2] * x + np.sin(b[3] * x))
    return b[0] * np.exp(x * np.log(b[1])) * rise * np.cos(x * np.exp(b[4]))


def _glasser_2_derivatives(inputs: Inputs, b: Theta) -> tuple[Any, ...]:
    x = inputs[0]
    grown, rise = np.exp(x * np.log(b[1])), np.tanh(b[2] * x + np.sin(b[3] * x))
    angle = x * np.exp(b[4])
    wave = grown * np.cos(angle)
    by_rise = b[0] * wave * (1 - rise * rise) * x
    by_angle = -b[0] * grown * rise * np.sin(angle) * angle
    return wave * rise, b[0] * wave * rise * x / b[1], by_rise, by_rise * np.cos(b[3] * x), by_angle


FORMS = {
    "bard": Form(bard, _bard_derivatives, 3, (1,)),
    "osborne_2": Form(osborne_2, _osborne_2_derivatives, 11, (1, 2, 3, 4)),
    "jennrich_sampson": Form(jennrich_sampson, _jennrich_sampson_derivatives, 2),
    "gulf": Form(gulf, _gulf_derivatives, 3),
    "glasser_1": Form(glasser_1, _glasser_1_derivatives, 4, (1,)),
    "glasser_2": Form(glasser_2, _glasser_2_derivatives, 5, (1,)),
}
