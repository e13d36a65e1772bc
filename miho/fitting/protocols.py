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

FILES: Mapping[str, str] = MappingProxyType({".tir": "miho.vehicle.models.tire_fit:tire_model"})
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

        Parameters
        ----------
        x, y, start, fixed, tied
            As for `miho.fit`.
        space : Space, mapping or collection of str
            Bounds of the free parameters, or their names alone.

        Returns
        -------
        model : Model
            The model.
        bounds : Space, mapping or None
            Bounds of the free parameters.
        start : mapping of str to float or None
            Start of the fit.
        """


@runtime_checkable
class Signed(Protocol):
    """A model of quantities with a sign convention."""

    def converted(
        self,
        inputs: Mapping[str, Array],
        output: Array,
        convention: str,
        ranges: Mapping[str, Sequence[float] | None] | None,
    ) -> tuple[dict[str, Array], Array]:
        """Return inputs and output in the model's signs.

        Parameters
        ----------
        inputs : mapping of str to ndarray, shape (N,)
            Columns of the inputs.
        output : ndarray, shape (N,)
            Column of the output.
        convention : str
            Name of the sign convention of the columns.
        ranges : mapping of str to sequence of float, or None
            Bounds of the largest magnitude of a column, see `miho.data.measurements.Layout`.

        Returns
        -------
        inputs : dict of str to ndarray, shape (N,)
            Columns of the inputs.
        output : ndarray, shape (N,)
            Column of the output.

        Raises
        ------
        ValueError
            If a value is impossible.
        """

    def check_signs(self, inputs: Mapping[str, Array]) -> None:
        """Check the signs of inputs.

        Parameters
        ----------
        inputs : mapping of str to ndarray, shape (N,)
            Columns of the inputs.

        Raises
        ------
        ValueError
            If inputs are not in the model's signs.
        """


@runtime_checkable
class Writable(Protocol):
    """A model that can be written as a file of its field."""

    def write(self, values: Mapping[str, float], path: str | os.PathLike[str]) -> None:
        """Write a file.

        Parameters
        ----------
        values : mapping of str to float
            Values of the parameters.
        path : path-like
            The file.
        """


def model_from(
    model: Any,
    x: Any,
    y: Any,
    space: Any,
    start: Mapping[str, float] | None,
    fixed: Mapping[str, float],
    tied: Mapping[str, str],
) -> Stated:
    """Return the model, bounds and start of a `Template` or of a file; other objects unchanged.

    Parameters
    ----------
    model : Template, path or object
        The object.
    x, y, space, start, fixed, tied
        As for `Template.model_for`.

    Returns
    -------
    model : Model
        The model.
    bounds : Space, mapping or None
        Bounds of the free parameters.
    start : mapping of str to float or None
        Start of the fit.
    """
    if isinstance(model, Template):
        return model.model_for(x, y, space, start, fixed, tied)
    if isinstance(model, str | os.PathLike):
        return model_of_file(model)(model, x, y, space, start, fixed, tied)
    return model, space, start


def model_of_file(path: str | os.PathLike[str]) -> Callable[..., Stated]:
    """Return the function that makes a model from a file.

    Parameters
    ----------
    path : path-like
        The file.

    Returns
    -------
    callable
        Its arguments are the path and the arguments of `Template.model_for`.

    Raises
    ------
    ValueError
        If no function is known for the suffix of the file.

    Examples
    --------
    >>> model_of_file("car.tir").__name__
    'tire_model'
    """
    place = FILES.get(Path(path).suffix.lower())
    if place is None:
        suffixes = ", ".join(FILES)
        raise ValueError(
            f"model is {os.fspath(path)!r}; expected a function, or a path that ends in {suffixes}"
        )
    module, _, name = place.partition(":")
    function: Callable[..., Stated] = getattr(import_module(module), name)
    return function
