"""Wait for many connections at once."""

from __future__ import annotations

import selectors
import sys
from multiprocessing import connection
from typing import Any


class Watch:
    """A set of connections and process sentinels to wait for.

    They are registered once: with many workers, registering them for every wait takes longer than a
    job.
    """

    def __init__(self) -> None:
        self._watched: set[Any] = set()
        self._selector = None if sys.platform == "win32" else selectors.DefaultSelector()

    def add(self, *objects: Any) -> None:
        """Add objects to wait for."""
        for item in objects:
            self._watched.add(item)
            if self._selector is not None:
                self._selector.register(item, selectors.EVENT_READ)

    def remove(self, *objects: Any) -> None:
        """Remove objects; call this before closing them."""
        for item in objects:
            self._watched.discard(item)
            if self._selector is not None:
                self._selector.unregister(item)

    def ready(self, seconds: float) -> set[Any]:
        """Objects that become readable or end within `seconds`."""
        if self._selector is None:
            return set(connection.wait(list(self._watched), seconds))
        return {key.fileobj for key, _ in self._selector.select(seconds)}
