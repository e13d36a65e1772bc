"""Alias of `miho.methods.dual_annealing` for configurations and stored runs."""

from miho.methods.dual_annealing import DualAnnealing

__all__ = ["DualAnnealing"]
