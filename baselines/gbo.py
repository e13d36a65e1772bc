"""`miho.methods.gbo` under the name that configurations and stored runs know."""

from miho.methods.gbo import GBO

__all__ = ["GBO"]
