"""Alias of `miho.methods.gbo` for configurations and stored runs."""

from miho.methods.gbo import GBO

__all__ = ["GBO"]
