"""A session: each row updates the method; its state is answered, stored, shown in a terminal."""

import json
import math
import os
import sys
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

from experiments.online.sources import Source, parsed
from miho.analysis.text import significant
from miho.online import Alarm, Running, TrackerState

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


STATES, ROWS = "states.csv", "rows.jsonl"
FLUSHED = 0.5
"""Seconds after which written states are on the disk."""


@dataclass
class Session:
    """A run of a method on a source, with its rows and states in files of `root`.

    Parameters
    ----------
    running : Running
        The method.
    columns : tuple of str
        Columns that a row must have.
    root : Path
        Folder of the states.
    words : mapping of str to str
        Names of parameters in alarms.
    view : LiveView, optional
        Terminal that shows the states.
    quiet : bool, optional
        Whether no state is answered.
    """

    running: Running
    columns: tuple[str, ...]
    root: Path
    words: Mapping[str, str] = field(default_factory=dict)
    view: LiveView | None = None
    quiet: bool = False
    last: TrackerState | None = field(default=None, init=False)
    alarms: list[Alarm] = field(default_factory=list, init=False)
    bad: int = field(default=0, init=False)

    def run(self, source: Source) -> None:
        """Take all rows of the source; a bad row is answered by its error and does not count."""
        self.root.mkdir(parents=True, exist_ok=True)
        with (
            (self.root / STATES).open("a", encoding="utf-8", newline="") as file,
            (self.root / ROWS).open("a", encoding="utf-8", newline="") as rows_file,
        ):
            written = time.monotonic()
            for row in source.rows():
                try:
                    values = parsed(row, self.columns) if isinstance(row, str) else row
                    state = self.running.update(values)
                except ValueError as error:
                    self.bad += 1
                    if not self.quiet:
                        source.answer(json.dumps({"error": str(error)}))
                    continue
                if state.alarm is not None:
                    self.alarms.append(state.alarm)
                self.last = state
                if not self.quiet:
                    source.answer(json.dumps(state_row(state, self.words)))
                if self.view is not None:
                    self.view.show(state, [in_words(alarm, self.words) for alarm in self.alarms])
                self._write(file, state)
                rows_file.write(json.dumps(values) + "\n")
                if time.monotonic() - written > FLUSHED:
                    file.flush()
                    rows_file.flush()
                    written = time.monotonic()

    def _write(self, file: TextIO, state: TrackerState) -> None:
        """Append the state to the CSV file, which begins with the names of its columns."""
        if file.tell() == 0:
            names = (f"{name}{end}" for name in state.names for end in ("", "_low", "_high"))
            file.write(",".join(("time", *names, "alarm")) + "\n")
        ends = state.intervals()
        numbers = [state.time]
        for k, value in enumerate(state.theta.tolist()):
            numbers += [value, float(ends[k, 0]), float(ends[k, 1])]
        alarm = "" if state.alarm is None else f'"{in_words(state.alarm, self.words)}"'
        file.write(",".join(f"{number:.8g}" for number in numbers) + f",{alarm}\n")


def state_row(state: TrackerState, words: Mapping[str, str]) -> dict[str, Any]:
    """Return a state as plain data for JSON; numbers that are not known are null."""
    ends = state.intervals()
    return {
        "time": known(state.time),
        "row": state.rows,
        "values": {name: known(value) for name, value in state.values.items()},
        "low": {n: known(float(e)) for n, e in zip(state.names, ends[:, 0], strict=True)},
        "high": {n: known(float(e)) for n, e in zip(state.names, ends[:, 1], strict=True)},
        "identifiable": dict(zip(state.names, state.identifiable.tolist(), strict=True)),
        "alarm": None if state.alarm is None else in_words(state.alarm, words),
        "seconds": state.seconds,
    }


def known(value: float) -> float | None:
    """Return the number, None for NaN and infinity, which JSON does not have."""
    return value if math.isfinite(value) else None


def in_words(alarm: Alarm, words: Mapping[str, str]) -> str:
    """Return the alarm with the names that the user gave to parameters, without underscores.

    Examples
    --------
    >>> in_words(Alarm(12.4, "D", 1000.0, 690.0, 40.0), {"D": "front grip"})
    'front grip fell by 31 ± 4 % at 12.4 s'
    """
    return str(alarm.with_names(lambda name: words.get(name, name.replace("_", " "))))


def replay(running: Running, path: Path) -> None:
    """Update the method with the rows of an earlier session, as that session did."""
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, 1):
            try:
                running.update(json.loads(line))
            except (ValueError, TypeError) as error:
                raise ValueError(f"{path}, line {number}: {error}") from None


def repair(path: Path) -> None:
    """Remove a last line without an end, which a session that was killed leaves, with a notice."""
    with path.open("rb") as file:
        last = b"".join(deque(file, maxlen=1))
    if last and not last.endswith(b"\n"):
        os.truncate(path, path.stat().st_size - len(last))
        print(f"{path}: the last line is cut off and was removed", file=sys.stderr)
