"""Alias of `miho.methods.variable_projection` for configurations and stored runs."""

from miho.methods.variable_projection import VariableProjection

__all__ = ["VariableProjection"]
