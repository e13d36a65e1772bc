"""`miho.methods.hickernell_yuan` under the name that configurations and stored runs know."""

from miho.methods.hickernell_yuan import HickernellYuan

__all__ = ["HickernellYuan"]
