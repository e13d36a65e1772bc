"""`miho.methods.differential_evolution` under the name that configurations and stored runs know."""

from miho.methods.differential_evolution import DifferentialEvolution

__all__ = ["DifferentialEvolution"]
