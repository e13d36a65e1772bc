"""Alias of `miho.methods.least_squares` for configurations and stored runs."""

from miho.methods.least_squares import LeastSquares

__all__ = ["LeastSquares"]
