"""The present state in a terminal: one line for each parameter, and the alarms in words."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TextIO

from miho.analysis.text import significant
from miho.online import TrackerState

PERIOD = 0.1
"""Time between two pictures [s]."""
SHOWN = 5
"""Number of alarms that are shown, the last ones."""


class LiveView:
    """A block of lines that is written again in its place."""

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream
        self._lines, self._due = 0, 0.0

    def show(self, state: TrackerState, alarms: Sequence[str], *, last: bool = False) -> None:
        """Show a state, unless the last picture is newer than `PERIOD`."""
        if not last and time.monotonic() < self._due:
            return
        self._due = time.monotonic() + PERIOD
        lines = picture(state, alarms)
        up = f"\x1b[{self._lines}A" if self._lines else ""
        self.stream.write(up + "".join(f"\x1b[2K{line}\n" for line in lines))
        self.stream.flush()
        self._lines = len(lines)


def picture(state: TrackerState, alarms: Sequence[str]) -> list[str]:
    """Return the lines of a state: time, value with interval and a scale, and the last alarms.

    A parameter that recent rows do not inform has the mark "not informed".
    """
    width = max(map(len, state.names))
    lines = [f"time {state.time:.2f} s, row {state.rows:,}, {1e6 * state.seconds:.0f} µs"]
    ends = state.intervals()
    for k, name in enumerate(state.names):
        low, high = (float(end) for end in ends[k])
        value = float(state.theta[k])
        mark = "" if state.identifiable[k] else "  not informed"
        lines.append(
            f"{name:<{width}}  {significant(value, 4):>9}  [{significant(low, 4)}, "
            f"{significant(high, 4)}]{mark}"
        )
    shown = list(alarms)[-SHOWN:]
    return lines + [f"alarm: {text}" for text in shown] + [""] * (SHOWN - len(shown))
