"""How a check fails."""

from __future__ import annotations


class ConformanceError(AssertionError):
    """A check that failed: its name and what was seen."""


class NoEvaluation(BaseException):
    """Raised in a method that makes no evaluations; no Exception, which a method might catch."""


def require(condition: bool, message: str) -> None:
    """Raise ConformanceError with this message unless the condition holds."""
    if not condition:
        raise ConformanceError(message)
