"""Models of published regression problems, by the name of their formula."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from baselines.problems import kinetics, mgh, nist
from baselines.problems.records import Form
from miho.models.symbolic import Symbol, trace
from miho.models.traced import TracedExpression

FORMS: Mapping[str, Form] = {**nist.FORMS, **mgh.FORMS, **kinetics.FORMS}


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
        if self.name not in FORMS:
            raise ValueError(f"name is {self.name!r}; choose from {', '.join(FORMS)}")

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
