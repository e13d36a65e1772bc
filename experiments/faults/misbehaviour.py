"""Jobs that go wrong, each in its way."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time


def misbehave(how: str) -> str:
    """Do what `how` says to this process; any other text is given back."""
    if how == "exit":
        sys.exit(7)
    if how == "leave":
        os._exit(9)
    if how == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if how == "hang":
        time.sleep(1000)
    while how == "deaf":
        with contextlib.suppress(KeyboardInterrupt):
            time.sleep(1000)
    if how == "raise":
        raise ValueError("no\n  good")
    if how == "memory":
        raise MemoryError
    return how
