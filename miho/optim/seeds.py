"""Random streams named by what they are for, so that no stream depends on another's use."""

from __future__ import annotations

import hashlib

import numpy as np

Part = str | int


def stream(*parts: Part) -> np.random.Generator:
    """A generator of its own for these named parts, the same on every machine.

    (problem, repetition) names what all methods share; a method's own stream adds its name.
    """
    name = "\0".join(f"{type(part).__name__}:{part}" for part in parts)
    entropy = int.from_bytes(hashlib.sha256(name.encode()).digest(), "little")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(entropy)))
