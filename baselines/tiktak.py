"""Alias of `miho.methods.tiktak` for configurations and stored runs."""

from miho.methods.tiktak import TikTak

__all__ = ["TikTak"]
