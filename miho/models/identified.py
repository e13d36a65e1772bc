"""`parameters.json`: an identified model with uncertainty, range of validity and provenance.

The file transfers identified models to the simulation of the car (`miho.vehicle.driving`).
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from miho.models.model import Model
from miho.quantities import Array
from miho.regular_file import read_regular
from miho.units import differ

FORMAT = 1
LARGEST = 16 << 20
"""Largest size of a parameters file [bytes]."""
MARGIN = 0.02
"""Tolerance at the ends of an input's range, as a fraction of the range."""


class OutsideDataWarning(UserWarning):
    """Warning for predictions outside the range of the data of an identified model."""


class UncheckedWarning(UserWarning):
    """Warning for a parameters file without a checksum, in which damage is not detected."""


class ParametersError(ValueError):
    """Error for a parameters file that cannot be used, in one line with the file and a remedy."""


@dataclass(frozen=True)
class Value:
    """An identified number with unit, standard error and interval; unknown parts are NaN."""

    value: float
    unit: str
    standard_error: float = math.nan
    low: float = math.nan
    high: float = math.nan

    def __post_init__(self) -> None:
        if not math.isfinite(self.value):
            raise ValueError(f"value is {self.value!r}; expected a finite number")


@dataclass(frozen=True, eq=False)
class Identified:
    """A model with identified parameters.

    Parameters
    ----------
    model : Model
        The model.
    parameters : Mapping[str, Value]
        Identified parameters, in the model's order.
    correlation : ndarray of shape (d, d)
        Correlation of the parameters.
    ranges : Mapping[str, tuple[float, float]]
        Smallest and largest value of each input in the data, in the model's units.
    derived : Mapping[str, Value]
        Quantities computed from the parameters.
    provenance : Mapping[str, Any]
        Record of the data, software and settings that reproduce the result.
    level : float, optional
        Confidence level of the intervals.

    Raises
    ------
    ValueError
        If parameters, units or ranges do not fit the model.
    """

    model: Model
    parameters: Mapping[str, Value]
    correlation: Array = field(repr=False)
    ranges: Mapping[str, tuple[float, float]]
    derived: Mapping[str, Value] = field(repr=False)
    provenance: Mapping[str, Any] = field(repr=False)
    level: float = 0.95

    def __post_init__(self) -> None:
        units = {name: value.unit for name, value in self.parameters.items()}
        pairs = zip(units.values(), self.model.parameters.values(), strict=False)
        wrong = any(differ(unit, needed) for unit, needed in pairs)
        if list(units) != list(self.model.parameters) or wrong:
            raise ValueError(
                f"parameters and units are {units}; model {type(self.model).__name__} needs "
                f"{dict(self.model.parameters)}"
            )
        if set(self.ranges) != set(self.model.inputs):
            raise ValueError(
                f"ranges has {', '.join(self.ranges)}; expected each input: "
                f"{', '.join(self.model.inputs)}"
            )

    @property
    def theta(self) -> Array:
        """Values of the parameters, (d,)."""
        return np.array([value.value for value in self.parameters.values()])

    def outside(self, *inputs: Array) -> list[str]:
        """Find the inputs that leave the range of the data.

        Parameters
        ----------
        *inputs : ndarray of shape (N,)
            Input columns, in the order and units of the model.

        Returns
        -------
        list of str
            A sentence for each such input.
        """
        sentences = []
        for (name, unit), values in zip(self.model.inputs.items(), inputs, strict=True):
            low, high = self.ranges[name]
            slack = MARGIN * (high - low)
            least, most = float(np.min(values)), float(np.max(values))
            if not (low - slack <= least and most <= high + slack):
                sentences.append(
                    f"{name} from {least:.6g} to {most:.6g} {unit} leaves the data "
                    f"({low:.6g} to {high:.6g} {unit})"
                )
        return sentences

    def predict(self, *inputs: Array) -> Array:
        """Evaluate the model; inputs outside the data cause an OutsideDataWarning.

        Parameters
        ----------
        *inputs : array_like of shape (N,)
            Input columns, in the order and units of the model.

        Returns
        -------
        ndarray of shape (N,)
            Output.
        """
        for sentence in self.outside(*inputs):
            text = f"{type(self.model).__name__}: {sentence}; this is extrapolation"
            warnings.warn(text, OutsideDataWarning, stacklevel=2)
        columns = [np.asarray(column, dtype=float) for column in inputs]
        return np.asarray(self.model.predict(self.theta[None], *columns)[0])


def parameters_text(identified: Identified, settings: Mapping[str, Any]) -> str:
    """Return the text of a parameters file; `settings` are the arguments of the model."""
    model = identified.model
    document = {
        "format": FORMAT,
        "model": {
            "name": type(model).__name__,
            "settings": dict(settings),
            "output": model.output,
            "inputs": {
                name: {"unit": unit, "low": identified.ranges[name][0],
                       "high": identified.ranges[name][1]}
                for name, unit in model.inputs.items()
            },
        },
        "level": identified.level,
        "parameters": {name: _plain(value) for name, value in identified.parameters.items()},
        "correlation": [[_number(r) for r in row] for row in identified.correlation.tolist()],
        "derived": {name: _plain(value) for name, value in identified.derived.items()},
        "provenance": dict(identified.provenance),
    }  # fmt: skip
    signed = {**document, "sha256": _digest(document)}
    return json.dumps(signed, indent=1, allow_nan=False) + "\n"


def read_parameters(path: str | os.PathLike[str], model: Model) -> Identified:
    """Read an identified model from a parameters file.

    A file without a checksum causes an UncheckedWarning. Older files have no checksum; remove its
    line if you edit a file by hand.

    Parameters
    ----------
    path : str or PathLike
        The parameters file.
    model : Model
        The model of the file, with the same settings.

    Returns
    -------
    Identified
        The model with parameters, uncertainty and ranges.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ParametersError
        If the file is damaged, or has another format or another model.
    """
    # Check the size, checksum and format.
    text = read_regular(path, LARGEST + 1)
    if len(text) > LARGEST:
        raise ParametersError(f"{path}: is larger than {LARGEST >> 20} MiB; name a parameters file")
    try:
        document = json.loads(text, parse_constant=_refused)
        digest = document.pop("sha256", None)
        if digest is None:
            warnings.warn(
                f"{path}: has no checksum, so damage is not detected", UncheckedWarning, 2
            )
        elif digest != _digest(document):
            raise ParametersError(
                f"{path}: checksum does not match the content; identify again, or remove the line "
                "sha256 if you edited the file"
            )
        if document["format"] != FORMAT:
            raise ParametersError(f"{path}: has format {document['format']!r}; expected {FORMAT}")
        # Check the model; `Identified` checks parameters, units and inputs.
        about = document["model"]
        name = type(model).__name__
        same = {"FunctionFormula": "FunctionModel"}  # a function before and after it is traced
        alike = same.get(about["name"], about["name"]) == same.get(name, name)
        if not alike or about["output"] != model.output:
            raise ParametersError(f"{path}: holds a {about['name']}; expected a {name}")
        return Identified(
            model=model,
            parameters={key: _value(entry) for key, entry in document["parameters"].items()},
            correlation=np.array(
                [[math.nan if r is None else float(r) for r in row]
                 for row in document["correlation"]]
            ),
            ranges={
                key: (float(entry["low"]), float(entry["high"]))
                for key, entry in about["inputs"].items()
            },
            derived={key: _value(entry) for key, entry in document["derived"].items()},
            provenance=document["provenance"],
            level=float(document["level"]),
        )  # fmt: skip
    except ParametersError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise ParametersError(
            f"{path}: is not a parameters file ({type(error).__name__}: {error}); identify again"
        ) from None


def _digest(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 digest of a document's content, independent of its layout."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _refused(constant: str) -> float:
    raise ValueError(f"contains {constant}")


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _plain(value: Value) -> dict[str, Any]:
    return {
        "value": value.value,
        "unit": value.unit,
        "standard_error": _number(value.standard_error),
        "interval": [_number(value.low), _number(value.high)],
    }


def _value(entry: Mapping[str, Any]) -> Value:
    numbers = [entry["standard_error"], *entry["interval"]]
    error, low, high = (math.nan if x is None else float(x) for x in numbers)
    return Value(float(entry["value"]), str(entry["unit"]), error, low, high)
