"""Alias of `miho.methods.scatter_search` for configurations and stored runs."""

from miho.methods.scatter_search import ScatterSearch

__all__ = ["ScatterSearch"]
