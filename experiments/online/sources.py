"""Sources of rows: JSON lines on stdin or a socket, a replayed dataset, a synthetic stream."""

import contextlib
import io
import json
import math
import socket
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, TextIO

import numpy as np

from baselines.online import Stream
from miho.online.outputs import TIME
from miho.quantities import Array
from miho.validate import is_number, positive, whole

LOOPBACK = ("127.0.0.1", "::1", "localhost")
"""Hosts that only programs of this machine reach."""


class Source(ABC):
    """A source of rows, which may want an answer to each of them."""

    @abstractmethod
    def rows(self) -> Iterator[str | Mapping[str, float]]:
        """Yield rows as mappings of columns, or as lines of JSON."""

    def answer(self, text: str) -> None:
        """Send the state after a row, in one line of JSON."""
        sys.stdout.write(text + "\n")
        sys.stdout.flush()


class Lines(Source):
    """JSON lines of a text stream, by default stdin; states go to stdout."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self.stream = sys.stdin if stream is None else stream
        if stream is None and isinstance(sys.stdin, io.TextIOWrapper):
            sys.stdin.reconfigure(encoding="utf-8", errors="replace")

    def rows(self) -> Iterator[str]:
        """Yield each line as soon as it has arrived."""
        return iter(self.stream.readline, "")


class Socket(Source):
    """JSON lines from one client after another; states go back to the client.

    Parameters
    ----------
    host : str, optional
        Address to which the server is bound; by default only this machine reaches it.
    port : int, optional
        Port; 0 chooses a free one.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        whole("stream.port", port, 0, 65_535)
        self.server = socket.create_server((host, port))
        self.port = self.server.getsockname()[1]
        self._client: TextIO | None = None
        print(f"waiting for rows on {host}:{self.port}", file=sys.stderr, flush=True)
        if host not in LOOPBACK:
            print(f"{host} is not the loopback: other machines may connect", file=sys.stderr)

    def rows(self) -> Iterator[str]:
        """Yield each line of each client, until the server is closed."""
        with self.server:
            while True:
                try:
                    connection, _ = self.server.accept()
                except OSError:  # closed from another thread
                    return
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                with (  # a file for both directions forgets lines that it has read ahead
                    connection,
                    contextlib.suppress(OSError),  # the client has gone
                    connection.makefile(encoding="utf-8", errors="replace") as lines,
                    connection.makefile("w", encoding="utf-8") as self._client,
                ):
                    yield from iter(lines.readline, "")
                self._client = None

    def answer(self, text: str) -> None:
        """Send the state to the client, unless it has gone."""
        if self._client is not None:
            with contextlib.suppress(OSError):
                self._client.write(text + "\n")
                self._client.flush()


class Replay(Source):
    """Recorded rows in their order.

    Parameters
    ----------
    columns : mapping of str to ndarray, shape (N,)
        The rows, with a column `time` [s] or with the time `period` between them.
    period : float
        Time between two rows [s].
    rate : float, optional
        Seconds of the rows per second of the replay; by default as fast as possible.
    """

    def __init__(
        self, columns: Mapping[str, Array], period: float, rate: float | None = None
    ) -> None:
        if rate is not None:
            positive("stream.rate", rate)
        rows = next(iter(columns.values())).size
        self.columns = {TIME: np.asarray(period * np.arange(rows), dtype=float), **columns}
        self.rate = rate

    def rows(self) -> Iterator[Mapping[str, float]]:
        """Yield the rows at the rate."""
        names, began = tuple(self.columns), time.monotonic()
        first = float(self.columns[TIME][0])
        for values in zip(*(column.tolist() for column in self.columns.values()), strict=True):
            row = dict(zip(names, values, strict=True))
            if self.rate is not None:
                due = began + (row[TIME] - first) / self.rate
                time.sleep(max(due - time.monotonic(), 0.0))
            yield row


class Synthetic(Source):
    """The rows of a stream with known truth."""

    def __init__(self, stream: Stream) -> None:
        self.stream = stream

    def rows(self) -> Iterator[Mapping[str, float]]:
        """Yield the rows."""
        return iter(self.stream)


def parsed(line: str, needed: tuple[str, ...]) -> dict[str, float]:
    """Return the row of a line of JSON; null and a missing column are NaN.

    Raises ValueError in one sentence if the line is not an object of numbers.
    """
    try:
        row: Any = json.loads(line, parse_int=float)
    except (ValueError, RecursionError) as error:
        reason = getattr(error, "msg", error)
        raise ValueError(f"the line is {line[:60]!r}; expected JSON ({reason})") from None
    if not isinstance(row, dict):
        raise ValueError(f"the row is {line[:60]!r}; expected an object of numbers by column")
    if not set(row) & set(needed):
        raise ValueError(f"the row has no column of {', '.join(needed)}")
    numbers = dict.fromkeys(needed, math.nan)
    for name, value in row.items():
        if value is None:
            value = math.nan
        if not is_number(value):
            raise ValueError(f"column {name!r} is {value!r}; expected a number or null")
        numbers[name] = float(value)
    return numbers
