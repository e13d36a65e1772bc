"""Errors on models and columns that a fit cannot take, each with its remedy."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miho.data.csv import TIME
from miho.models.joint import parts_of
from miho.models.layout import OUTPUT, PART
from miho.models.model import Model

COMPLEX = (
    "miho.fit_joint({{'real': (lambda ...: model(...).real, x, {0}.real), "
    "'imag': (lambda ...: model(...).imag, x, {0}.imag)}}, bounds)"
)
"""The call that fits complex numbers."""


def no_model(model: object) -> ValueError:
    """The error on an object that is neither a function nor a model."""
    from miho.fitting.protocols import Template

    name = type(model).__name__
    if isinstance(model, type):
        name = model.__name__
        return ValueError(f"model is the class {name}; expected an object, for example {name}()")
    if isinstance(model, Template):  # a model only with its parameters
        return ValueError(
            f"the model is a {name}; expected its parameters as well, for example "
            f"{model.with_parameters}"
        )
    return ValueError(
        f"model is of type {name}; expected a function; the order of the arguments is model, x, y, "
        "bounds"
    )


def other_number(model: Model, count: int) -> ValueError:
    """The error on more or fewer columns than a model has inputs."""
    if PART in model.inputs:
        return _no_part(model)
    names = ", ".join(model.inputs)
    return ValueError(
        f"x has {count} columns; expected {len(model.inputs)} for {model.name}: {names}; give them "
        "as a tuple or by name"
    )


def _no_part(model: Model) -> ValueError:
    """The error on inputs of a joint fit without the number of a part."""
    name = parts_of(model)[0].name
    return ValueError(f"x is of no part; choose one, as in fit.part({name!r}).predict(x)")


def no_column(model: Model, lacking: Sequence[str]) -> ValueError:
    """The error on input columns that a model needs and the data do not have."""
    if PART in lacking:
        return _no_part(model)
    several = "; fit each output as a part of miho.fit_joint" * (OUTPUT in lacking)
    return ValueError(
        f"x has no column {', '.join(lacking)}; expected {', '.join(model.inputs)} for "
        f"{model.name or type(model).__name__}{several}"
    )


def no_argument(names: Sequence[str], parameters: Collection[str]) -> ValueError:
    """The error on fewer arguments of a function than columns before its parameters."""
    return ValueError(
        f"{next(name for name in names if name in parameters)} has bounds, but x has {len(names)} "
        f"column{'s' * (len(names) > 1)}, for the arguments {', '.join(names)}; give the model "
        "an argument for each column, before the parameters"
    )


def no_numbers(name: str, values: Any) -> ValueError:
    """The error on a column that is not one of real numbers."""
    array = np.asarray(values)
    if array.dtype.kind == "c":
        return ValueError(
            f"{name} is {array.dtype}; expected real numbers; fit real and imaginary parts, for "
            f"example by {COMPLEX.format(name)}"
        )
    if array.dtype.kind in "mM":
        passed = f"({name} - {name}.min())" if array.dtype.kind == "M" else name
        return ValueError(
            f"{name} is {array.dtype}; expected real numbers, for example the seconds "
            f"{passed} / pandas.Timedelta(seconds=1)"
        )
    if name in getattr(values, "columns", ()) and array.shape[1] > 1:
        return ValueError(f"x has {array.shape[1]} columns {name}; rename or drop all but one")
    if array.ndim > 1:
        single = array.size == max(array.shape)
        remedy = f"numpy.ravel({name})"
        if not single:
            remedy = f"several columns as a tuple or by name, a grid as {remedy}"
        return ValueError(
            f"{name} has the shape {array.shape}; expected a column (N,); give {remedy}"
        )
    value, row = _first_word(array)
    if isinstance(value, datetime):  # with a time zone
        return ValueError(
            f"{name} is {str(value)!r}{row}; expected real numbers, for example the seconds "
            f"({name} - {name}.min()) / pandas.Timedelta(seconds=1)"
        )
    times = isinstance(value, str) and TIME.search(value)
    hint = f"; convert times by pandas.to_datetime({name})" if times else ""
    return ValueError(f"{name} is {value!r}{row}; expected real numbers{hint}")


def _first_word(array: NDArray[Any]) -> tuple[object, str]:
    """The first entry of a column that is no number, and its place."""
    for row, value in enumerate(np.atleast_1d(array).tolist()):
        try:
            float(value)
        except (TypeError, ValueError):
            return value, f" in row {row + 1}" * bool(array.ndim)
    return array.dtype.name, ""
