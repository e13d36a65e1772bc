"""`miho.methods.hyperband` under the name that configurations and stored runs know."""

from miho.methods.hyperband import Hyperband, SuccessiveHalving

__all__ = ["Hyperband", "SuccessiveHalving"]
