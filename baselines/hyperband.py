"""Alias of `miho.methods.hyperband` for configurations and stored runs."""

from miho.methods.hyperband import Hyperband, SuccessiveHalving

__all__ = ["Hyperband", "SuccessiveHalving"]
