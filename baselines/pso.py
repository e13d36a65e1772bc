"""`miho.methods.pso` under the name that configurations and stored runs know."""

from miho.methods.pso import PSO

__all__ = ["PSO"]
