"""`miho.methods.scatter_search` under the name that configurations and stored runs know."""

from miho.methods.scatter_search import ScatterSearch

__all__ = ["ScatterSearch"]
