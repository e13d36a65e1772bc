"""Failures of checks."""

from __future__ import annotations


class ConformanceError(AssertionError):
    """A failed check: its name and the observation."""


class NoEvaluation(BaseException):
    """A method makes no evaluations. Not an Exception, which a method might catch."""


def require(condition: bool, message: str) -> None:
    """Raise ConformanceError with this message unless the condition is true."""
    if not condition:
        raise ConformanceError(message)
