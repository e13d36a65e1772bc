"""Random streams by name, so that no stream depends on the use of another."""

from __future__ import annotations

import hashlib

import numpy as np

Part = str | int


def stream(*parts: Part) -> np.random.Generator:
    """Independent random generator for these named parts, the same on every machine.

    (problem, repetition) names the streams that all methods share; the stream of one method adds
    its name.
    """
    name = "\0".join(f"{type(part).__name__}:{part}" for part in parts)
    words = np.frombuffer(hashlib.sha256(name.encode()).digest(), "<u4")
    while not words[-1]:  # NumPy divides an integer into words without leading zeros
        words = words[:-1]
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(words)))
