"""Progress of a run on a terminal, off its clock."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from tqdm import tqdm

from miho.optim import Budget, Oracle


class Observer(Protocol):
    """Called with the oracle about ten times a second."""

    def __call__(self, oracle: Oracle) -> None:
        """Show where the run stands."""


@contextmanager
def progress(title: str, budget: Budget, unit: str) -> Iterator[Observer]:
    """A bar that fills with the budget and shows the best error; silent if not on a terminal."""
    in_seconds = budget.evaluations is None and budget.seconds is not None
    total = budget.seconds if in_seconds else budget.evaluations
    layout = "{percentage:3.0f}% |{bar}| {desc}" if total else "{desc}"
    with tqdm(total=total, desc=title, leave=False, disable=None, bar_format=layout) as bar:

        def observe(oracle: Oracle) -> None:
            spent = oracle.meter.seconds if in_seconds else oracle.evaluations
            bar.n = min(spent, total) if total else spent
            error = math.sqrt(max(0.0, oracle.best))
            bar.set_description_str(
                f"{title}: {error:.5g} {unit}, {oracle.evaluations:,.0f} evaluations, "
                f"{oracle.meter.seconds:.1f} s"
            )

        yield observe
