"""Work arrays of Gauss-Newton steps, as parts of one array."""

from __future__ import annotations

from typing import NamedTuple

from miho.quantities import Array

CHUNK = 512
"""Rows per chunk; their derivatives stay in the first-level cache."""


class SolverScratch(NamedTuple):
    """Work arrays of `miho.compiled.triangular.solve_in_box`, for at most d parameters.

    free (d,): 1, 0 or DEPENDENT; solution (d,); columns (d + 1, 2 d); T (d + 1, d + 1).
    """

    free: Array
    solution: Array
    columns: Array
    T: Array


class Work(NamedTuple):
    """Work arrays for the steps of one candidate with d parameters, m rows and some levels.

    theta, step, low, high, scale (d,): the configuration in units, a step, its bounds and damping.
    sums (levels,): sums of squares. T (d + 1, d + 1): a triangular factor. chunk (d + 1, CHUNK):
    columns to fold into T. slopes (d, CHUNK), residuals (m,): values from the problem.
    """

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
    solver: SolverScratch


def room_for(d: int, m: int, levels: int) -> int:
    """Number of elements that `work` needs."""
    return levels + (d + 1) * (d + 1) + (2 * d + 1) * CHUNK + m + 7 * d + (d + 1) * (3 * d + 1)


def work(room: Array, d: int, m: int, levels: int) -> Work:
    """Parts of `room` for d parameters, m residuals and levels of rows; factor and sums are 0."""
    n, start = d + 1, 7 * d
    sums = room[start : start + levels]
    for k in range(levels):
        sums[k] = 0.0
    start += levels
    T = room[start : start + n * n].reshape((n, n))
    clear(T)
    start += n * n
    chunk = room[start : start + n * CHUNK].reshape((n, CHUNK))
    start += n * CHUNK
    slopes = room[start : start + d * CHUNK].reshape((d, CHUNK))
    start += d * CHUNK
    residuals = room[start : start + m]
    start += m
    columns = room[start : start + n * 2 * d].reshape((n, 2 * d))
    start += n * 2 * d
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
        SolverScratch(
            room[5 * d : 6 * d],
            room[6 * d : 7 * d],
            columns,
            room[start : start + n * n].reshape((n, n)),
        ),
    )


def clear(T: Array) -> None:
    """Set all elements to 0."""
    T[:] = 0.0


def copy(source: Array, target: Array) -> None:
    """Copy all elements of one array to another."""
    target[: source.size] = source
