"""`miho.methods.tiktak` under the name that configurations and stored runs know."""

from miho.methods.tiktak import TikTak

__all__ = ["TikTak"]
