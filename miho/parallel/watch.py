"""Waiting for many connections at once."""

from __future__ import annotations

import selectors
import sys
from multiprocessing import connection
from typing import Any


class Watch:
    """Connections and ends of processes that are waited for together.

    They are registered once: for many workers, doing that at every wait takes longer than a job.
    """

    def __init__(self) -> None:
        self._watched: set[Any] = set()
        self._selector = None if sys.platform == "win32" else selectors.DefaultSelector()

    def add(self, *objects: Any) -> None:
        """Wait for these from now on."""
        for item in objects:
            self._watched.add(item)
            if self._selector is not None:
                self._selector.register(item, selectors.EVENT_READ)

    def remove(self, *objects: Any) -> None:
        """Wait for these no longer; to be called before they are closed."""
        for item in objects:
            self._watched.discard(item)
            if self._selector is not None:
                self._selector.unregister(item)

    def ready(self, seconds: float) -> set[Any]:
        """Those that can be read, or have ended, within some seconds."""
        if self._selector is None:
            return set(connection.wait(list(self._watched), seconds))
        return {key.fileobj for key, _ in self._selector.select(seconds)}
