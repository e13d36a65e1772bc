"""Alias of `miho.methods.differential_evolution` for configurations and stored runs."""

from miho.methods.differential_evolution import DifferentialEvolution

__all__ = ["DifferentialEvolution"]
