"""R32: as many dense inequalities as parameters, whose elimination has no end."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from miho import Parameter, Space
from miho.identification.constraints import constrained, free_values
from miho.models.tied import Ties
from tests.faults.conftest import Figures

SIZES = 6, 12, 20, 40
DRAWS = 1000
ROUNDING = 1e-9
"""Of sums of up to 40 numbers near 1, divided by a room of at least 1e-3, with a factor of 100."""


@pytest.mark.slow
@pytest.mark.fault(
    row="R32",
    fault=f"{', '.join(map(str, SIZES))} dense inequalities of as many parameters",
    promise="each becomes a box in seconds, none of it outside, and what is inside is reached",
)
def test_dense_constraints(tmp_path: Path, measured: Figures) -> None:
    """Draws from the box against the inequalities, and back to the box from the draws."""
    rng = np.random.default_rng(0)
    outside = missed = 0
    seconds = []
    for size in SIZES:
        names = tuple(f"x{k}" for k in range(size))
        A = rng.normal(size=(size, size)).round(6)
        b = (A.sum(axis=1) / 2 + 0.3 * np.abs(A).sum(axis=1) * rng.random(size)).round(6)
        sums = [
            " + ".join(f"{a!r} * {n}" for a, n in zip(r, names, strict=True)) for r in A.tolist()
        ]
        texts = [f"{sum_} < {end!r}" for sum_, end in zip(sums, b.tolist(), strict=True)]
        started = time.perf_counter()
        space = constrained(Space(tuple(Parameter(n, "-", 0.0, 1.0) for n in names)), texts)
        seconds.append(time.perf_counter() - started)
        held = {p.name: p.tied for p in space.parameters if p.tied}
        ties = Ties(names, dict.fromkeys(space.free.names, ""), held, radial=space.radial)
        shares = space.free.sample(DRAWS, rng, "uniform")
        points = ties.whole(shares)
        inside = (points @ A.T <= b + ROUNDING).all(axis=1)
        outside += int((~inside | (points < 0).any(axis=1) | (points > 1).any(axis=1)).sum())
        for point, share in zip(points[:20].tolist(), shares, strict=False):
            back = free_values(space.free, ties, dict(zip(names, point, strict=True)))
            missed += not np.allclose(back, share, rtol=0, atol=1e-6)
    took = ", ".join(f"{second:.1f}" for second in seconds)
    measured(
        f"{took} s; {outside} of {len(SIZES) * DRAWS} configurations outside, {missed} not reached"
    )
    assert outside == missed == 0
