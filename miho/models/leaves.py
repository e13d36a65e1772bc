"""The models that a model is made of and that may be dear: how they are called, and by whom."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from miho.models.fingerprint import fingerprint
from miho.models.function_calls import UNTRIED, Calls
from miho.models.function_model import FunctionModel
from miho.models.model import Model
from miho.models.spread import SpreadModel
from miho.parallel import Evaluations
from miho.quantities import Array

DIGITS = 16
"""Of the digests that tell what a journal is of."""


def dear_leaves(model: Model) -> list[Model]:
    """The models that a model is made of and that may be dear, in their order."""
    leaves = list[Model]()

    def note(leaf: Model) -> Model:
        leaves.append(leaf)
        return leaf

    model.with_leaves(note)
    return leaves


def spread(
    model: Model, evaluations: Evaluations, losses: Callable[[Array], Array] | None = None
) -> Model:
    """The model with outputs of its leaves that are evaluated by these.

    `losses` (n,) of its outputs (n, N) are those of its only leaf, if it has no other.
    """
    count, of_leaf = itertools.count(), losses if len(dear_leaves(model)) == 1 else None
    return model.with_leaves(
        lambda leaf: SpreadModel(leaf, evaluations, f"model {next(count)}", of_leaf)
    )


def tried_calls(model: Model) -> list[list[bool | None]]:
    """What trial calls have shown of its functions (`Calls`), nothing for other leaves."""
    leaves = dear_leaves(model)
    return [list(leaf.tried) if isinstance(leaf, FunctionModel) else [] for leaf in leaves]


def called(model: Model, calls: Iterable[Any]) -> Model:
    """The model, whose functions are called as `tried_calls` said of the same one, if anything."""
    known = iter(calls)

    def as_known(leaf: Model) -> Model:
        tried = next(known, None)
        if tried is None or not isinstance(leaf, FunctionModel):
            return leaf
        return replace(leaf, tried=Calls(*tried))

    return model.with_leaves(as_known)


def description(model: Model, columns: Sequence[Array]) -> str:
    """Digests of columns of data and of the leaves, whatever is known of how they are called."""
    data = hashlib.sha256()
    for column in columns:
        data.update(np.ascontiguousarray(column).tobytes())
    leaves = [
        replace(leaf, batched=None, rowwise=None, tried=UNTRIED)
        if isinstance(leaf, FunctionModel)
        else leaf
        for leaf in dear_leaves(model)
    ]
    return f"data {data.hexdigest()[:DIGITS]} model {fingerprint(leaves)[:DIGITS]}"
