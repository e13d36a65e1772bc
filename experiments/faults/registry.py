"""The rows of the fault table in their order, and where each is done."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from experiments.faults.row import Row


@dataclass(frozen=True)
class Entry:
    """A row's number, and the module and function that does it.

    `long`: it takes the most time; `quick`: it takes little; `timed`: it judges seconds, so nothing
    else may run beside it; `times`: how often it does its fault, if not as often as the table asks.
    """

    number: str
    name: str
    long: bool = False
    quick: bool = False
    timed: bool = False
    times: int | None = None

    @property
    def module(self) -> str:
        """The dotted name."""
        return f"experiments.faults.{self.name}"

    @property
    def exists(self) -> bool:
        """Whether its module is there; nothing is imported."""
        return importlib.util.find_spec(self.module) is not None

    def load(self) -> Callable[[Path], Row]:
        """The function that does the fault in an empty folder and measures."""
        function: Callable[..., Row] = getattr(importlib.import_module(self.module), self.name)
        return function if self.times is None else partial(function, times=self.times)


ENTRIES = (
    Entry("R1", "kills"),
    Entry("R2", "full_disk"),
    Entry("R3", "isolation"),
    Entry("R4", "signals", long=True),
    Entry("R5", "sharing"),
    Entry("R6", "identical_sweeps"),
    Entry("R7", "damage"),
    Entry("R8", "objectives"),
    Entry("R9", "clock", quick=True),
    Entry("R10", "loading", timed=True),
    Entry("R11", "overhead", timed=True),
    Entry("R12", "timing", timed=True),
    Entry("R13", "malformed"),
    Entry("R14", "targets", quick=True),
    Entry("R15", "names", quick=True),
    Entry("R16", "secrets"),
    Entry("R17", "changes"),
    Entry("R18", "schedule", quick=True),
    Entry("R19", "determinism"),
    Entry("R20", "tracker", timed=True),
    Entry("R21", "places"),
    Entry("R22", "neighbours"),
    Entry("R23", "own_models"),
    Entry("R24", "received_files"),
    Entry("R25", "silence"),
    Entry("R26", "other_machines"),
)
