"""Alias of `miho.methods.hickernell_yuan` for configurations and stored runs."""

from miho.methods.hickernell_yuan import HickernellYuan

__all__ = ["HickernellYuan"]
