"""Identification: the problem made of a model, a dataset and a space, and what it can tell."""

from miho.identification.curve_fit import CurveFit
from miho.identification.irreducible import irreducible_error

__all__ = ["CurveFit", "irreducible_error"]
