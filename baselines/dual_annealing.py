"""`miho.methods.dual_annealing` under the name that configurations and stored runs know."""

from miho.methods.dual_annealing import DualAnnealing

__all__ = ["DualAnnealing"]
