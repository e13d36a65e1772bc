"""Components of a model that may be expensive: how they are called, and where."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from miho.models.function_calls import UNTRIED, Calls
from miho.models.function_model import FunctionModel
from miho.models.model import Model, expensive_leaves
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.parallel import Evaluations

DIGITS = 16
"""Length of the digests that identify a journal."""


def spread(
    model: Model, evaluations: Evaluations, losses: Callable[[Array], Array] | None = None
) -> Model:
    """Return the model with its leaves evaluated by `evaluations`.

    `losses` maps outputs (n, N) to losses (n,). It is used only if the model has a single leaf.
    """
    from miho.models.spread import SpreadModel

    count, of_leaf = itertools.count(), losses if len(expensive_leaves(model)) == 1 else None
    return model.with_leaves(
        lambda leaf: SpreadModel(leaf, evaluations, f"model {next(count)}", of_leaf)
    )


def tried_calls(model: Model) -> list[list[bool | None]]:
    """Return the results of trial calls (`Calls`) of each leaf, [] unless it is a function."""
    leaves = expensive_leaves(model)
    return [list(leaf.tried) if isinstance(leaf, FunctionModel) else [] for leaf in leaves]


def called(model: Model, calls: Iterable[Any]) -> Model:
    """Return the model with its functions called as found by `tried_calls` of the same model."""
    known = iter(calls)

    def as_known(leaf: Model) -> Model:
        tried = next(known, None)
        if tried is None or not isinstance(leaf, FunctionModel):
            return leaf
        return replace(leaf, tried=Calls(*tried))

    return model.with_leaves(as_known)


def description(model: Model, columns: Sequence[Array]) -> str:
    """Return digests of data columns and leaves, independent of the results of trial calls."""
    from miho.models.fingerprint import fingerprint

    data = hashlib.sha256()
    for column in columns:
        data.update(np.ascontiguousarray(column).tobytes())
    leaves = [
        replace(leaf, batched=None, rowwise=None, tried=UNTRIED)
        if isinstance(leaf, FunctionModel)
        else leaf
        for leaf in expensive_leaves(model)
    ]
    return f"data {data.hexdigest()[:DIGITS]} model {fingerprint(leaves)[:DIGITS]}"
