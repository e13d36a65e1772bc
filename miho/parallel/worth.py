"""Durations of evaluations: which count as expensive, and how they are printed."""

from __future__ import annotations

EXPENSIVE = 0.01
"""Seconds from which an evaluation counts as expensive: it is written to the journal, and no
evaluation is made speculatively."""


def is_expensive(seconds: float, evaluations: float = 1) -> bool:
    """Return whether evaluations that took so long together are expensive."""
    return seconds >= EXPENSIVE * evaluations


def span(seconds: float) -> str:
    """Seconds as text in s, ms or µs."""
    if seconds >= 1:
        return f"{seconds:.3g} s"
    return f"{seconds * 1e3:.3g} ms" if seconds >= 1e-3 else f"{seconds * 1e6:.3g} µs"
