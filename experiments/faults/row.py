"""One row of the fault table: what was done to the program and what it did."""

from __future__ import annotations

from dataclasses import dataclass

NOT_JUDGED = "not judged"
"""How a measure begins that this machine, busy with other work, does not let judge."""


@dataclass(frozen=True)
class Row:
    """A measured row: its number (R1 to R26), the fault, the goal, the figure, the verdict."""

    number: str
    fault: str
    goal: str
    measured: str
    met: bool
