"""Fields of wrapped models by their former names, in pickles of earlier versions."""

import pytest

from miho.models import FunctionModel
from miho.models.function_model import FunctionFormula
from miho.quantities import Array


def line(x: Array, *, a: float, b: float) -> Array:
    return a + b * x


@pytest.mark.parametrize("former", ["function", "joint"])
def test_older_pickles_are_restored(former: str) -> None:
    model = FunctionModel(line)
    restored = FunctionFormula.__new__(FunctionFormula)
    restored.__setstate__({former: model})
    assert restored.model is model
    assert list(restored.parameters) == ["a", "b"]
