"""The two sets of least-squares problems in conf/problem, and the rule that writes them."""

from collections import Counter

import pytest

from experiments.app.compose import CONF
from experiments.check.residual_problems import files, problems

POSED = {posed.name: posed for posed in problems()}
STARTS = (
    7.20000e+01, 1.12500e+03, 1.16542e+07, 1.16859e+09, 4.98920e+06, 5.00936e+08, 2.42000e+01,
    1.79577e+06, 2.50000e+03, 1.06000e+04, 2.15000e+02, 1.61540e+06, 4.00500e+02, 1.54575e+08,
    4.16817e+01, 1.30623e+03, 5.31317e-03, 1.69361e+09, 1.64308e+01, 2.32337e+06, 2.69042e+01,
    8.15888e+06, 7.36782e+01, 2.05938e+07, 1.03115e+03, 4.17131e+03, 7.92669e+06, 3.08106e+11,
    4.64282e-02, 3.37706e-02, 3.86177e-02, 2.88830e-02, 3.37633e-02, 2.67406e-02, 2.73248e+02,
    1.61741e+01, 2.09342e+00, 1.99685e+02, 9.04000e+02, 1.35600e+03, 1.58200e+03, 1.80800e+03,
    5.65000e+01, 7.05625e+01, 9.86875e+01, 2.53908e+09, 6.87380e+12, 3.36796e+09, 3.73513e+09,
    3.99107e+09, 1.13001e+13, 9.38567e+00, 3.36582e+10,
)  # fmt: skip
"""Sums of squares at the 53 starts, as Moré and Wild print them (testout.dat of BenDFO)."""


def test_the_files_are_as_their_rule_says() -> None:
    """They are written by it: `python -m experiments.check.residual_problems`."""
    for file, text in files().items():
        assert file.read_text(encoding="utf-8") == text, file.name


def test_the_sets_are_whole_and_there_is_no_other_file() -> None:
    assert Counter(posed.collection for posed in POSED.values()) == {"mw": 53, "cr": 36}
    there = {path.stem for path in (CONF / "problem").glob("*.yaml")}
    assert {name for name in there if name.startswith(("mw_", "cr_"))} == set(POSED)


@pytest.mark.parametrize("name", POSED)
def test_the_start_lies_inside_the_box(name: str) -> None:
    posed = POSED[name]
    assert len(posed.start) == len(posed.box) == posed.length
    ranges = zip(posed.start, posed.box.values(), strict=True)
    assert all(box.low < x < box.high for x, box in ranges)


@pytest.mark.parametrize(("name", "squares"), [*zip(list(POSED)[:53], STARTS, strict=True)])
def test_the_start_has_the_sum_of_squares_of_more_and_wild(name: str, squares: float) -> None:
    """To the six digits that are printed: half a unit of the last is 5e-6 at most."""
    posed = POSED[name]
    assert float((posed.residuals(posed.start) ** 2).sum()) == pytest.approx(squares, rel=6e-6)
