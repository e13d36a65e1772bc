"""Room in which Gauss-Newton steps are worked out, as parts of one array."""

from __future__ import annotations

from typing import NamedTuple

from miho.compiled.triangular import Room, compiled
from miho.quantities import Array

CHUNK = 512
"""Rows at a time: their derivatives stay in the first-level cache."""


class Work(NamedTuple):
    """Room for one configuration: residuals (m,), rows of a chunk, factors, a step."""

    theta: Array
    step: Array
    low: Array
    high: Array
    scale: Array
    sums: Array
    T: Array
    chunk: Array
    slopes: Array
    residuals: Array
    room: Room


def room_for(d: int, m: int, levels: int) -> int:
    """Numbers that `work` needs."""
    return levels + (d + 1) * (d + 1) + (2 * d + 1) * CHUNK + m + 7 * d + (d + 1) * (3 * d + 1)


@compiled
def work(room: Array, d: int, m: int, levels: int) -> Work:
    """Room for d parameters, m residuals and levels of rows; the factor and the sums are 0."""
    n, at = d + 1, 7 * d
    sums = room[at : at + levels]
    for k in range(levels):
        sums[k] = 0.0
    at += levels
    T = room[at : at + n * n].reshape((n, n))
    clear(T)
    at += n * n
    chunk = room[at : at + n * CHUNK].reshape((n, CHUNK))
    at += n * CHUNK
    slopes = room[at : at + d * CHUNK].reshape((d, CHUNK))
    at += d * CHUNK
    residuals = room[at : at + m]
    at += m
    columns = room[at : at + n * 2 * d].reshape((n, 2 * d))
    at += n * 2 * d
    return Work(
        room[:d],
        room[d : 2 * d],
        room[2 * d : 3 * d],
        room[3 * d : 4 * d],
        room[4 * d : 5 * d],
        sums,
        T,
        chunk,
        slopes,
        residuals,
        Room(
            room[5 * d : 6 * d],
            room[6 * d : 7 * d],
            columns,
            room[at : at + n * n].reshape((n, n)),
        ),
    )


@compiled
def clear(T: Array) -> None:
    """Make all numbers 0."""
    for j in range(T.shape[0]):
        for k in range(T.shape[1]):
            T[j, k] = 0.0


@compiled
def copy(these: Array, to: Array) -> None:
    """Copy numbers."""
    for k in range(these.size):
        to[k] = these[k]
