"""`miho.methods.variable_projection` under the name that configurations and stored runs know."""

from miho.methods.variable_projection import VariableProjection

__all__ = ["VariableProjection"]
