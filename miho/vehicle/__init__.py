"""Vehicles: models of tires, engine, brake and motion, their data, and simulated drives.

The rest of `miho` does not import this package; it extends the core with models and datasets.
"""

from miho.exports import at_first_use

__all__: list[str] = []

__getattr__, __dir__ = at_first_use(__name__)
