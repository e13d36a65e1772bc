"""`miho.methods.least_squares` under the name that configurations and stored runs know."""

from miho.methods.least_squares import LeastSquares

__all__ = ["LeastSquares"]
