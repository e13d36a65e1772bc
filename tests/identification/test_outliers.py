"""Remarks on outliers."""

from __future__ import annotations

import numpy as np
import pytest

import miho
from miho.quantities import Array

T = np.linspace(0, 2, 60)
BOX = {"a": (0, 5), "b": (0, 10)}


def decay(t: Array, a: float, b: float) -> Array:
    return np.asarray(a * np.exp(-b * t))


def remarks(errors: Array, loss: str | None = None) -> list[str]:
    sigma = None if loss is None else 0.05
    fit = miho.fit(decay, T, decay(T, 2.0, 1.5) + errors, BOX, sigma=sigma, loss=loss)
    return [note for note in fit.report(profiles=False).notes if "robust loss" in note]


@pytest.mark.parametrize(
    ("rows", "words"), [([7], "1 of 60 rows is"), ([7, 30], "2 of 60 rows are")]
)
def test_few_rows_far_from_the_curve_are_named(rows: list[int], words: str) -> None:
    errors = 0.05 * np.random.default_rng(0).standard_normal(T.size)
    errors[rows] += 1.0
    (note,) = remarks(errors)
    assert note.startswith(words)
    scale = float(note.rpartition("scale ")[2].rstrip("."))
    assert scale == pytest.approx(1.345 * 0.05, rel=0.5), "the outliers hardly count"
    assert not remarks(errors, "huber")


def test_normal_errors_have_no_outliers() -> None:
    for seed in range(20):
        assert not remarks(0.05 * np.random.default_rng(seed).standard_normal(T.size))


def test_intervals_that_outliers_do_not_widen_have_no_remark() -> None:
    y = decay(T, 2.0, 1.5) + 0.05 * np.random.default_rng(0).standard_normal(T.size)
    y[7] += 1.0
    prior = {"a": {"low": 0, "high": 5, "prior": (2.0, 0.1)}, "b": (0, 10)}
    for space, sigma in ((BOX, 0.05), (prior, None)):
        notes = miho.fit(decay, T, y, space, sigma=sigma).report(profiles=False).notes
        assert not [note for note in notes if "more than 5 standard deviations" in note]
