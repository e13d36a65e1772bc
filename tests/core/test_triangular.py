"""The doors of the machine for factors and small problems; tests/compiled has their results."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from miho.core import machine

pytestmark = pytest.mark.skipif(machine() is None, reason="the machine was not built")


def test_sizes_that_do_not_fit_are_refused() -> None:
    T, columns, v, s = np.zeros((3, 3)), np.ones((3, 8)), np.ones(3), np.empty(3)
    for rows, n in ((9, 3), (8, 4), (-1, 3), (8, -1)):
        with pytest.raises(ValueError, match="fold: expected no more rows"):
            machine().fold(T, columns, rows, n)
    with pytest.raises(ValueError, match="T has another type or shape"):
        machine().fold(np.zeros(3), columns, 8, 3)
    with pytest.raises(ValueError, match="overlaps"):
        machine().fold(columns.ravel()[:9].reshape(3, 3), columns, 8, 3)
    with pytest.raises(ValueError, match="solve_in_box: R has fewer parameters"):
        machine().solve_in_box(T[:2], v, v, -v, v, s)
    with pytest.raises(ValueError, match="a vector is shorter than the step"):
        machine().solve_in_box(T, v, v[:2], -v, v, s)
    with pytest.raises(ValueError, match="overlaps"):
        machine().solve_in_box(T, v, v, -v, s, s)
    with pytest.raises(TypeError, match="takes 6 arguments"):
        machine().solve_in_box(T, v)


def test_none_keeps_its_references() -> None:
    """Also in a build by another version of Python, where None may be immortal."""
    T, columns = np.zeros((3, 3)), np.ones((3, 8))
    before = sys.getrefcount(None)
    for _ in range(1000):
        machine().fold(T, columns, 8, 3)
    assert abs(sys.getrefcount(None) - before) < 500
