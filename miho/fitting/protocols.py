"""Methods by which an object of some field, for example a tire, takes part in a fit."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol, runtime_checkable

from miho.models.model import Model
from miho.optim import Space
from miho.quantities import Array

Stated = tuple[Model, Space | Mapping[str, Any] | None, Mapping[str, float] | None]
"""A model with bounds and start."""

FILES: Mapping[str, str] = MappingProxyType({".tir": "miho.vehicle.models.tire_formula:tire_model"})
"""The function that makes a model from a file, by the suffix of the file; it is imported at its
first use. Its arguments are the path and the arguments of `Template.model_for`."""


@runtime_checkable
class Template(Protocol):
    """An object that becomes a model when columns and free parameters are known.

    Attributes
    ----------
    with_parameters : str
        An example of such a model, as Python text.
    """

    with_parameters: str

    def model_for(
        self,
        x: Any,
        y: Any,
        space: Space | Mapping[str, Any] | Collection[str],
        start: Mapping[str, float] | None,
        fixed: Mapping[str, float],
        tied: Mapping[str, str],
    ) -> Stated:
        """Return the model, bounds and start from the arguments of `miho.fit`.

        `space` may be the names of the free parameters alone.
        """


@runtime_checkable
class Signed(Protocol):
    """A model of quantities with a sign convention."""

    def check_data(
        self,
        inputs: Mapping[str, Array],
        output: Array,
        convention: str,
        ranges: Mapping[str, Sequence[float] | None] | None,
        largest: Mapping[str, float],
    ) -> None:
        """Raise ValueError for impossible input and output columns (N,) in signs of a convention.

        `miho.data.measurements.Layout` documents `ranges`; `largest` are the largest values of
        parameters that are known, by name.
        """

    def converted(
        self, inputs: Mapping[str, Array], output: Array, convention: str
    ) -> tuple[dict[str, Array], Array]:
        """Return input and output columns (N,) in the model's signs."""

    def check_signs(self, inputs: Mapping[str, Array]) -> None:
        """Raise ValueError for input columns (N,) that are not in the model's signs."""


@runtime_checkable
class Writable(Protocol):
    """A model that can be written as a file of its field."""

    def write(self, values: Mapping[str, float], path: str | os.PathLike[str]) -> None:
        """Write a file with these values of the parameters."""


def model_from(model: Any, *arguments: Any) -> Stated:
    """The model, bounds and start of a `Template` or of a file; other objects are unchanged.

    `arguments` are the arguments of `Template.model_for`. Raises ValueError for a file with an
    unknown suffix.
    """
    if isinstance(model, Template):
        return model.model_for(*arguments)
    if not isinstance(model, str | os.PathLike):
        return model, arguments[2], arguments[3]
    place = FILES.get(Path(model).suffix.lower())
    if place is None:
        suffixes = ", ".join(FILES)
        raise ValueError(
            f"model is {os.fspath(model)!r}; expected a function, or a path that ends in {suffixes}"
        )
    module, _, name = place.partition(":")
    function: Callable[..., Stated] = getattr(import_module(module), name)
    return function(model, *arguments)
