"""One line of a diagnosis."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class State(StrEnum):
    """How bad it is: nothing, worth knowing, or something to mend."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "failed"


@dataclass(frozen=True)
class Check:
    """What was looked at, how it is, and what was seen and is to be done."""

    name: str
    state: State
    told: str

    @property
    def line(self) -> str:
        """For the terminal."""
        return f"{self.name:<18} {self.state:<8} {self.told}"
