"""One published formula: what a table of them holds."""

from __future__ import annotations

from dataclasses import dataclass

from miho.compiled.kernel import Formula


@dataclass(frozen=True)
class Form:
    """A formula of `inputs` columns and `parameters` numbers, its derivatives with respect to them.

    The output is jointly linear in the parameters whose numbers, from 1, `linear` holds.
    """

    value: Formula
    derivatives: Formula
    parameters: int
    linear: tuple[int, ...] = ()
    inputs: int = 1
