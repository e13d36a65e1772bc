"""The figure of what to measure next draws each row and each quantity."""

import numpy as np
import pandas as pd
import pytest

from miho.analysis import design_figure


def rows(*inputs: str) -> pd.DataFrame:
    """Four present rows, eight candidates, of which the last is chosen twice."""
    parts = ["present"] * 4 + ["candidate"] * 8 + ["chosen"] * 2
    values = np.concatenate([np.arange(4.0), np.arange(8.0), [7.0, 7.0]])
    return pd.DataFrame(dict.fromkeys(inputs, values) | {"row": parts})


def table() -> pd.DataFrame:
    return pd.DataFrame(
        {
            "quantity": ["B", "C"],
            "present half width": [4.0, np.inf],
            "expected half width": [1.0, 3.0],
            "evenly half width": [2.0, np.inf],
        }
    )


def test_one_input_is_counted() -> None:
    left, right = design_figure(rows("x [m]"), table()).axes
    heights = [sum(bar.get_height() for bar in bars) for bars in left.containers]  # type: ignore[attr-defined]
    assert heights == [4, 2]
    assert left.get_xlabel() == "x [m]"
    points = [np.asarray(part.get_offsets()) for part in right.collections[1:]]
    assert [part[0, 0] for part in points] == [50.0, 25.0]
    assert [text.get_text() for text in right.texts] == ["determined for the first time"]


def test_two_inputs_are_a_map() -> None:
    frame = rows("x [m]", "same [-]", "y [N]", "z [-]").assign(**{"same [-]": 1.0})
    left, _ = design_figure(frame, table()).axes
    counts = [len(np.asarray(part.get_offsets())) for part in left.collections]
    assert counts == [8, 4, 1]
    assert (left.get_xlabel(), left.get_ylabel()) == ("x [m]", "y [N]")


@pytest.mark.parametrize("value", [0.0, 5e4])
def test_an_input_that_never_changes_is_drawn(value: float) -> None:
    design_figure(rows("x [m]").assign(**{"x [m]": value}), table())
