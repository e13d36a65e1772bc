"""Alias of `miho.methods.pso` for configurations and stored runs."""

from miho.methods.pso import PSO

__all__ = ["PSO"]
