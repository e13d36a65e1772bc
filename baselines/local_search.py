"""Alias of `miho.methods.local_search` for configurations and stored runs."""

from miho.methods.local_search import LBFGSB, NelderMead

__all__ = ["LBFGSB", "NelderMead"]
