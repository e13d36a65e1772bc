"""Record of a published formula."""

from __future__ import annotations

from dataclasses import dataclass

from miho.compiled.kernel import Formula


@dataclass(frozen=True)
class Form:
    """A formula of `inputs` columns and `parameters` numbers, with derivatives by the parameters.

    `linear` has the numbers, from 1, of parameters in which the output is jointly linear.
    """

    value: Formula
    derivatives: Formula
    parameters: int
    linear: tuple[int, ...] = ()
    inputs: int = 1
