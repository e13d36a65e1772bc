"""`miho.methods.local_search` under the name that configurations and stored runs know."""

from miho.methods.local_search import LBFGSB, NelderMead

__all__ = ["LBFGSB", "NelderMead"]
