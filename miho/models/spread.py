"""Components of a model that may be expensive: how they are called, and where."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from miho.models.derived import Derived
from miho.models.function_calls import UNTRIED, Calls
from miho.models.function_model import FunctionModel
from miho.models.model import DifferencedModel, Model, Wrapper, expensive_leaves
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.parallel import Evaluated, Evaluations


class SpreadModel(Wrapper):
    """A model whose parameter rows are evaluated by `evaluations`.

    Differences are computed in this process, from outputs of the workers. Analytic derivatives are
    evaluated by workers. `place` identifies the model within its problem. `losses` maps outputs
    (n, N) to losses (n,), if known; they show which evaluations are best.
    """

    def __init__(
        self,
        model: Model,
        evaluations: Evaluations,
        place: str,
        losses: Callable[[Array], Array] | None = None,
    ) -> None:
        self.model, self._evaluations, self._place = model, evaluations, place
        self._losses = losses
        self._tasks: dict[tuple[str, bytes], Evaluated] = {}
        self._digests: dict[tuple[int, ...], tuple[tuple[Array, ...], bytes]] = {}

    @property
    def ordered(self) -> bool:
        """Whether the model is ordered."""
        return self.model.ordered

    @property
    def jacobian_cost(self) -> int | None:
        """Cost of a Jacobian of the model."""
        return self.model.jacobian_cost

    def derived_quantities(self, columns: Mapping[str, Array]) -> tuple[Derived, ...]:
        """Return the quantities of the model."""
        return self.model.derived_quantities(columns)

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Return the outputs (n, N) of parameter rows (n, d)."""
        if self._evaluations.resting():
            return self._evaluations.worth.brief(self.model.predict, thetas, *inputs)
        return self._task("predict", inputs, self.model.predict, (inputs[0].size,))(thetas)

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Return the derivatives of the outputs, (N, d)."""
        if isinstance(self.model, DifferencedModel):
            return np.asarray(self.model.differences(self.predict, theta, *inputs))
        if self._evaluations.resting():
            return np.asarray(self.model.jacobian(theta, *inputs))
        shape = (inputs[0].size, theta.size)
        jacobians = partial(_jacobians, self.model.jacobian)
        return np.asarray(self._task("jacobian", inputs, jacobians, shape)(theta[None])[0])

    def known(self, *inputs: Array) -> tuple[Array, Array]:
        """Return parameter rows (n, d) and outputs (n, N) at these inputs from the journal."""
        known = self._evaluations.known(self._name("predict", self._digest(inputs)))
        thetas, outputs = zip(*known, strict=True) if known else ((), ())
        rows = np.reshape(thetas, (-1, len(self.parameters)))
        return rows, np.reshape(outputs, (-1, inputs[0].size))

    def _name(self, kind: str, digest: bytes) -> str:
        return f"{self._place} {kind} {digest.hex()}"

    def _task(
        self,
        kind: str,
        inputs: tuple[Array, ...],
        function: Callable[..., Array],
        shape: tuple[int, ...],
    ) -> Evaluated:
        """Return the evaluated function at these inputs, which are sent to workers once."""
        digest = self._digest(inputs)
        if (kind, digest) not in self._tasks:
            columns = tuple(np.array(column) for column in inputs)
            rows, name = partial(_at_inputs, function, columns), self._name(kind, digest)
            losses = self._losses if kind == "predict" else None
            self._tasks[kind, digest] = self._evaluations.function(name, rows, shape, losses)
        return self._tasks[kind, digest]

    def _digest(self, inputs: tuple[Array, ...]) -> bytes:
        """Return a digest of the inputs, cached for the same arrays."""
        identity = tuple(map(id, inputs))
        if identity not in self._digests:
            digest = hashlib.blake2b(digest_size=8)
            for column in inputs:
                digest.update(np.ascontiguousarray(column).tobytes())
            if len(self._digests) > MOST_INPUTS:
                self._digests.clear()
            self._digests[identity] = inputs, digest.digest()  # keeps the arrays alive
        return self._digests[identity][1]


MOST_INPUTS = 64
"""Largest number of cached digests."""


def _at_inputs(function: Callable[..., Array], inputs: tuple[Array, ...], thetas: Array) -> Array:
    return np.asarray(function(thetas, *inputs))


def _jacobians(jacobian: Callable[..., Array], thetas: Array, *inputs: Array) -> Array:
    return np.array([jacobian(theta, *inputs) for theta in thetas])


DIGITS = 16
"""Length of the digests that identify a journal."""


def spread(
    model: Model, evaluations: Evaluations, losses: Callable[[Array], Array] | None = None
) -> Model:
    """Return the model with its leaves evaluated by `evaluations`.

    `losses` maps outputs (n, N) to losses (n,). It is used only if the model has a single leaf.
    """
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
