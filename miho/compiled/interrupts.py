"""How a user's Ctrl-C ends compilation: between two functions."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Any, cast

from numba.core import event


def stopping_compilation(interrupts: Sequence[object]) -> AbstractContextManager[object]:
    """Within this context, compiling raises KeyboardInterrupt once `interrupts` is not empty."""
    listener = _Stop(interrupts)
    return cast(AbstractContextManager[object], event.install_listener("numba:compile", listener))


class _Stop(event.Listener):  # type: ignore[misc]
    def __init__(self, interrupts: Sequence[object]) -> None:
        self.interrupts = interrupts

    def on_start(self, event: Any) -> None:
        """Called by numba."""
        if self.interrupts:
            raise KeyboardInterrupt

    def on_end(self, event: Any) -> None:
        """Called by numba."""
