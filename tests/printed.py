"""Printed results without their line breaks."""

from __future__ import annotations


def flat(result: object) -> str:
    """What a result prints, in one line with single spaces."""
    return " ".join(str(result).split())
