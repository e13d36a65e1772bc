"""Models of published regression problems, by the name of their formula; see `nist` for more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from baselines.problems import nist
from baselines.problems.records import Form, Inputs, Theta
from miho.models.symbolic import Symbol, trace
from miho.models.traced import TracedExpression
from miho.validate import one_of


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


FORMS: Mapping[str, Form] = {
    **nist.FORMS,
    "bard": Form(bard, 3),
    "osborne_2": Form(osborne_2, 11),
    "jennrich_sampson": Form(jennrich_sampson, 2),
    "gulf": Form(gulf, 3),
    "glasser_1": Form(glasser_1, 4),
    "glasser_2": Form(glasser_2, 5),
    "michaelis_menten": Form(michaelis_menten, 2),
    "isomerization": Form(isomerization, 4, inputs=3),
    "two_decays": Form(two_decays, 4),
    "lubricant": Form(lubricant, 9, inputs=2),
    "chloride": Form(chloride, 3),
    "tetracycline": Form(tetracycline, 4),
    "first_order": Form(first_order, 3, inputs=2),
    "gompertz": Form(gompertz, 3),
}


@dataclass(frozen=True)
class PublishedModel(TracedExpression):
    """A formula of the literature, with the numbers of its publication and without units.

    Parameters are b1, b2, ...; the input is x, or x1, x2, ... if there are several. If a formula
    has no value, for example a power of a negative base, the output is NaN or infinite.

    Parameters
    ----------
    name : str
        Name of the formula, a key of `FORMS`.

    Raises
    ------
    ValueError
        If there is no such formula.

    Examples
    --------
    >>> model = PublishedModel("rise")
    >>> list(model.parameters)
    ['b1', 'b2']
    """

    name: str

    output = "-"

    def __post_init__(self) -> None:
        one_of("name", self.name, FORMS)

    @property
    def form(self) -> Form:
        """The formula."""
        return FORMS[self.name]

    @property
    def inputs(self) -> Mapping[str, str]:
        """The input columns."""
        count = self.form.inputs
        return dict.fromkeys(("x",) if count == 1 else _numbered("x", count), "-")

    @property
    def parameters(self) -> Mapping[str, str]:
        """b1, b2, ..."""
        return dict.fromkeys(_numbered("b", self.form.parameters), "-")

    @property
    def linear(self) -> tuple[str, ...]:
        """The parameters in which the output is jointly linear."""
        return self.jointly_linear

    @cached_property
    def graph(self) -> Symbol:
        """Graph of the output."""
        return trace(self.form.value, self.columns, self.arguments)


def _numbered(letter: str, count: int) -> tuple[str, ...]:
    return tuple(f"{letter}{number}" for number in range(1, count + 1))
