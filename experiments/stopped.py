"""How a signal ends a command."""

from __future__ import annotations

import signal

HANG_UP = getattr(signal, "SIGHUP", None)
"""What a closed terminal sends; Windows has none."""


class Stopped(KeyboardInterrupt):
    """A signal ended what was going on; `number` is its number."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def ignores_hang_up() -> bool:
    """Whether this process was told to go on when its terminal closes, as nohup does."""
    return HANG_UP is None or signal.getsignal(HANG_UP) is signal.SIG_IGN
