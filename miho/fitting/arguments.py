"""The arguments of a fit: columns, bounds and units, as dataset, model and space."""

from __future__ import annotations

import dataclasses
import inspect
import math
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from miho.data.dataset import Dataset
from miho.models.function_model import FunctionModel, plain_of
from miho.models.model import Model
from miho.optim import Parameter, Space
from miho.validate import one_of

if TYPE_CHECKING:
    from miho.fitting.protocols import Signed

FAR = 1e6
"""The search range of a parameter without bounds: this multiple of its start on either side."""
OPEN = {"low": -math.inf, "high": math.inf}
"""Ends of a range without bounds."""
DENSE = 10.0
"""The same multiple with dense constraints; longer rays would resolve too little."""
NEAR = 0.1
"""A model is tried at values of parameters without bounds that differ by this share from their
start."""

SETTINGS = tuple(field.name for field in dataclasses.fields(Parameter))[1:-1]
"""The settings of a parameter that a mapping of bounds may have."""
Stated = Sequence[Space | Mapping[str, Any] | None]
"""Bounds, fixed values and others by name of the parameter."""
MISSING = ("raise", "drop")
"""The treatment of rows with a missing number."""


def by_label(label: str, values: Any) -> Mapping[str, Any] | None:
    """Start, fixed or tied values by name, also of a Series; raises ValueError for others."""
    if values is None or isinstance(values, Mapping):
        return values
    if hasattr(values, "to_dict") and hasattr(values, "index") and np.ndim(values) == 1:
        return dict(values.to_dict())
    example = {"a": "2 * b"} if label == "tied" else {"a": 1}
    shown = " ".join(repr(values).split())
    raise ValueError(f"{label} is {shown}; give its values by name, as in {example}")


def data_of(
    model: Any,
    x: Any,
    y: Any,
    sigma: Any,
    missing: str = "raise",
    convention: str = "iso-w",
    ranges: Mapping[str, Sequence[float] | None] | None = None,
    stated: Stated = (),
) -> tuple[Dataset, Model, str | float | None]:
    """The dataset, the model with the units that its function declares, and sigma.

    Sigma becomes a number or the name of a column of the dataset. Names in `stated` are parameters,
    even if `x` has columns of the same names. `missing` ("raise" or "drop") is the treatment of
    rows with a missing number. `miho.data.measurements.Layout` documents `convention` and `ranges`.
    """
    one_of("missing", missing, MISSING)
    output = y if isinstance(y, str) else _label(y)
    values = _column_of(x, "y", y)
    model = model_of(model, x, stated)
    inputs = inputs_of(model, x)
    _check_alignment(x, values, sigma)
    values = numbers_in(output, values)
    if convention != "iso-w" or ranges or signed_model(model) is not None:
        from miho.fitting.datasets import in_signs_of

        inputs, values = in_signs_of(model, inputs, values, convention, ranges, stated)
    while output in inputs:
        output += "_"
    columns = {**inputs, output: values}
    known = x.units if isinstance(x, Dataset) else {}
    units = {name: known.get(name) or unit for name, unit in model.inputs.items()}
    units[output] = (known.get(y) if isinstance(y, str) else None) or model.output
    unit = (known.get(sigma) if isinstance(sigma, str) else None) or model.output
    sigma = _column_of(x, "sigma", sigma)
    if sigma is not None and not np.ndim(sigma):
        if np.asarray(sigma).dtype != bool:  # which CurveFit refuses
            sigma = float(sigma)
    elif sigma is not None:
        name = "sigma"
        while name in columns:
            name += "_"
        columns[name], units[name], sigma = numbers_in(name, sigma), unit, name
    columns = _complete(model.name or "data", columns, missing)
    return Dataset(model.name or "data", columns, units, output), model, sigma


def model_of(model: Any, x: Any, stated: Stated = ()) -> Model:
    """A model, or the model of a function of the columns x; raises ValueError for anything else."""
    if isinstance(model, Model):
        return model
    if isinstance(model, type) or not callable(model):
        from miho.fitting.refused_columns import no_model

        raise no_model(model)
    names = {name for each in stated for name in named(each)}
    return FunctionModel(model, columns=_column_names(model, x, names))


def named(bounds: Space | Mapping[str, Any] | None) -> Mapping[str, Any]:
    """Bounds or other values by name."""
    if isinstance(bounds, Space):
        return {parameter.name: parameter for parameter in bounds.parameters}
    return bounds if isinstance(bounds, Mapping) else {}


def signed_model(model: Model) -> Signed | None:
    """The model if its quantities have a sign convention; a function has none."""
    if isinstance(model, FunctionModel):
        return None
    from miho.fitting.protocols import Signed

    return model if isinstance(model, Signed) else None


def by_name(x: Any) -> bool:
    """Whether columns are given by name, in a mapping or a data frame."""
    return isinstance(x, Mapping) or hasattr(x, "columns")


def _label(y: Any) -> str:
    """The name of a pandas column; "y" for other columns."""
    name = getattr(y, "name", None)
    return name if name and isinstance(name, str) and hasattr(y, "iloc") else "y"


def _column_of(x: Any, label: str, value: Any) -> Any:
    """The column of x with this name; `value` itself unless it is a name."""
    if not isinstance(value, str):
        return value
    if not by_name(x) or value not in x:
        names = f", one of {', '.join(map(str, x))}" if by_name(x) else ", with x by name"
        raise ValueError(
            f"{label} is {value!r}; expected values, or the name of a column of x{names}"
        )
    return x[value]


def _complete(
    name: str, columns: dict[str, NDArray[np.float64]], missing: str
) -> dict[str, NDArray[np.float64]]:
    """The columns without rows that miss a number; raises ValueError unless `missing` is "drop"."""
    lacking = {key: np.isnan(column) for key, column in columns.items()}
    if not any(rows.any() for rows in lacking.values()):
        return columns
    if len({column.size for column in columns.values()}) > 1:
        return columns  # the dataset refuses them
    dropped = np.logical_or.reduce(list(lacking.values()))
    affected = ", ".join(key for key, rows in lacking.items() if rows.any())
    count = f"{np.count_nonzero(dropped):,} of {dropped.size:,} rows"
    if missing == "raise" or dropped.all():
        raise ValueError(
            f"{affected}: a number is missing (NaN) in {count}, first in row "
            f"{np.flatnonzero(dropped)[0] + 1}; drop these rows, for example by missing='drop' of "
            "miho.fit, or by dropna of a data frame"
        )
    sys.stderr.write(f"miho: {name}: {count} are dropped: a number is missing in {affected}\n")
    return {key: column[~dropped] for key, column in columns.items()}


def _check_alignment(x: Any, y: Any, sigma: Any) -> None:
    """Refuse pandas columns of the same length with different row labels."""
    mapping = isinstance(x, Mapping) and not hasattr(x, "iloc")
    columns = x.values() if mapping else x if isinstance(x, tuple) else (x,)
    labels = [part.index for part in (*columns, y, sigma) if hasattr(part, "iloc")]
    for other in labels[1:]:
        if len(other) == len(labels[0]) and not other.equals(labels[0]):
            raise ValueError(
                "x, y and sigma have different row labels; align them, for example by "
                "y.loc[x.index], or give y.to_numpy() to match rows by position"
            )


def _column_names(function: Any, x: Any, parameters: set[str]) -> tuple[str, ...]:
    """The arguments of a function that are columns.

    The result is empty if the function marks columns by a *. Otherwise they are the arguments with
    the name of a column of x, or as many of the first arguments as x has columns.
    """
    try:
        arguments = inspect.signature(function).parameters
    except (TypeError, ValueError):
        return ()  # the function model refuses it
    plain = plain_of(function)  # arguments after one that a partial binds are keyword-only
    own = arguments if plain is function else inspect.signature(plain).parameters
    if any(a.kind is a.KEYWORD_ONLY for a in own.values()):
        return ()
    if by_name(x):
        names = tuple(name for name in arguments if name in x and name not in parameters)
        if not names:
            raise ValueError(
                f"x has the columns {', '.join(map(str, x))}; expected at least one with the name "
                f"of an argument of the model ({', '.join(arguments)}) that has no bounds"
            )
        return names
    free = [name for name, value in arguments.items() if value.default is value.empty]
    names = tuple(free)[: len(x) if isinstance(x, tuple) else 1]
    if not parameters.isdisjoint(names):
        from miho.fitting.refused_columns import no_argument

        raise no_argument(names, parameters)
    return names


def inputs_of(model: Model, x: Any) -> dict[str, Any]:
    """The input columns by name."""
    names = list(model.inputs)
    if by_name(x):
        lacking = [name for name in names if name not in x]
        if lacking:
            from miho.fitting.refused_columns import no_column

            raise no_column(model, lacking)
        return {name: numbers_in(name, x[name]) for name in names}
    columns = x if isinstance(x, tuple) else (x,)
    if len(columns) != len(names):
        from miho.fitting.refused_columns import other_number

        raise other_number(model, len(columns))
    return {name: numbers_in(name, column) for name, column in zip(names, columns, strict=True)}


def numbers_in(name: str, values: Any, axes: int = 1) -> NDArray[np.float64]:
    """A column as real numbers, NaN for missing ones; refuses conversions that lose information.

    `axes` is the largest number of its axes.
    """
    array = np.asarray(values)
    if array.dtype.kind in "cmM" or array.ndim > axes:
        raise _refused(name, values)
    if np.ma.is_masked(values):
        return np.where(np.ma.getmaskarray(values), np.nan, array.astype(float))
    if array.dtype == object:  # None or pandas.NA may represent a missing number
        import pandas as pd

        array = np.where(pd.isna(array), np.nan, array)
    try:
        return array.astype(float)
    except (TypeError, ValueError):
        raise _refused(name, array) from None


def _refused(name: str, values: Any) -> ValueError:
    from miho.fitting.refused_columns import no_numbers

    return no_numbers(name, values)


def number_of(label: str, value: Any) -> float:
    """A finite number; raises ValueError for anything else, which `label` names."""
    try:
        number = math.nan if isinstance(value, bool | np.bool) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"{label} is {value!r}; expected a finite number")
    return number


def space_of(
    model: Model,
    bounds: Space | Mapping[str, Any] | None,
    start: Mapping[str, float] | None,
    fixed: Mapping[str, float],
    tied: Mapping[str, str],
    reach: float = FAR,
) -> Space:
    """The space from bounds, start, fixed and tied parameters; parameters of the model come first.

    Without a bound, the range of a parameter ends at `reach` times its start.
    """
    ranges = named(bounds)
    names = list(dict.fromkeys([*model.parameters, *ranges]))
    for name in fixed:
        if name in tied:
            raise ValueError(
                f"{name} is fixed to {fixed[name]!r} and tied to {tied[name]!r}; choose one"
            )
    for label, part in (("start", start or {}), ("fixed", fixed), ("tied", tied)):
        for name in part:
            if name not in names:
                quantity = f", or add {{{name!r}: {{}}}} to the bounds, as a quantity"
                added = quantity * (label == "tied")
                raise ValueError(
                    f"{label}: {name} is not a parameter; choose from {', '.join(names)}{added}"
                )
    parameters = []
    for name in names:
        unit = model.parameters.get(name, "")
        settings = _settings(name, ranges.get(name))
        open_ends = [end for end, far in OPEN.items() if settings.get(end, far) == far]
        if name in fixed:
            settings |= {"fixed": number_of(f"fixed: {name}", fixed[name])}
        elif name in tied:
            settings |= {"tied": tied[name]}
        elif start is not None and name in start and open_ends:
            _check_start(name, settings, start)
            at = number_of(f"start: {name}", start[name])
            ends = at - reach * max(abs(at), 1.0), at + reach * max(abs(at), 1.0)
            if settings.get("scale") == "log" and at > 0:
                ends = at / reach, at * reach
            # A model is tried near the start: far away, a simulation may take very long.
            spread = NEAR if settings.get("scale") == "log" else NEAR * (abs(at) or 1.0)
            stated = {key: value for key, value in settings.items() if key not in open_ends}
            settings = {"low": ends[0], "high": ends[1], "mean": at, "std": spread, **stated}
        elif not settings and name in model.defaults:
            settings = {"fixed": model.defaults[name]}
        elif not settings:
            unknown = [other for other in ranges if other not in model.parameters]
            hint = f"; {model.name} has no parameter {', '.join(unknown)}" * bool(unknown)
            raise ValueError(
                f"{name} has no bounds; give them, for example {{{name!r}: (0, 10)}}, or a start "
                f"of every parameter{hint}"
            )
        elif start is not None and not _held(settings):
            _check_start(name, settings, start)
        try:
            parameters.append(Parameter(**{"name": name, "unit": unit, **settings}))
        except TypeError as error:
            raise ValueError(f"bounds of {name}: {error}") from None
    return Space(tuple(parameters))


def _check_start(name: str, settings: Mapping[str, Any], start: Mapping[str, float]) -> None:
    """Raise ValueError unless a free parameter with bounds has a start within them."""
    if name not in start:
        raise ValueError(f"start: lacks {name}; give a start of every free parameter")
    at = number_of(f"start: {name}", start[name])
    low, high = settings.get("low", -math.inf), settings.get("high", math.inf)
    if low < high and not low <= at <= high:
        raise ValueError(f"start: {name} is {at:g}; give one from {low:g} to {high:g}, or no start")


def _held(settings: Mapping[str, Any]) -> bool:
    """Whether a parameter is fixed or tied."""
    low, high = settings.get("low"), settings.get("high")
    return bool(settings.get("fixed") is not None or settings.get("tied")) or (
        low is not None and low == high
    )


def _settings(name: str, bounds: Any) -> dict[str, Any]:
    """The settings of a parameter from a `Parameter`, a mapping or a pair of bounds."""
    if bounds is None:
        return {}
    if isinstance(bounds, Parameter):
        return vars(bounds).copy()
    if isinstance(bounds, Mapping):
        unknown = [key for key in bounds if key not in SETTINGS]
        if unknown:
            raise ValueError(
                f"bounds of {name}: {unknown[0]} is not a setting; choose from "
                f"{', '.join(SETTINGS)}"
            )
        return dict(bounds)
    if isinstance(bounds, np.ndarray):
        bounds = bounds.tolist()
    if isinstance(bounds, Sequence) and not isinstance(bounds, str) and len(bounds) == 2:
        try:
            return {"low": float(bounds[0]), "high": float(bounds[1])}
        except (TypeError, ValueError):
            pass
    raise ValueError(f"bounds of {name} are {bounds!r}; expected (low, high), for example (0, 10)")
