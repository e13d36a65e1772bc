"""`parameters.json`: an identified model with uncertainty, range of validity and provenance.

It is the one way from identification to driving.
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

FORMAT = 1
LARGEST = 16 << 20
"""No parameters file is larger, in bytes."""
MARGIN = 0.02
"""An input this fraction of the data's range beyond its end still counts as inside."""


class OutsideDataWarning(UserWarning):
    """A model was asked about inputs beyond the data it was identified from."""


class UncheckedWarning(UserWarning):
    """A parameters file has no checksum, so damage to it would go unnoticed."""


class ParametersError(ValueError):
    """A parameters file that cannot be used: one line with the file, the field and the remedy."""


@dataclass(frozen=True)
class Value:
    """An identified number: unit, standard error and interval; NaN and infinite where unknown."""

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

    `parameters` in the model's order; `ranges` holds the smallest and largest value of each input
    in the data, in the model's units; `correlation` (d, d) is that of the parameters; `derived`
    are quantities computed from them; `provenance` says what regenerates all this.
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
        if list(units.items()) != list(self.model.parameters.items()):
            raise ValueError(
                f"parameters are {units}; model {type(self.model).__name__} needs "
                f"{dict(self.model.parameters)}"
            )
        if set(self.ranges) != set(self.model.inputs):
            raise ValueError(f"ranges are given of {', '.join(self.ranges)}; expected each input")

    @property
    def theta(self) -> Array:
        """The parameters' values, (d,)."""
        return np.array([value.value for value in self.parameters.values()])

    def outside(self, *inputs: Array) -> list[str]:
        """A sentence for each input that leaves the range of the data."""
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
        """Output (N,) at input columns (N,); warns with OutsideDataWarning beyond the data."""
        for sentence in self.outside(*inputs):
            text = f"{type(self.model).__name__}: {sentence}; this is extrapolation"
            warnings.warn(text, OutsideDataWarning, stacklevel=2)
        return np.asarray(self.model.predict(self.theta[None], *inputs)[0])


def parameters_text(identified: Identified, settings: Mapping[str, Any]) -> str:
    """The text of a parameters file; `settings` are what the model was built from."""
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
    """The identified model in a parameters file, which must be one of `model`'s.

    Raises ParametersError for a file that is damaged, of another format or of another model,
    FileNotFoundError if there is none. Warns with UncheckedWarning of a file without a checksum:
    older ones have none, and who edits a file by hand removes the line.
    """
    # What is written by `parameters_text`, and as it was written.
    text = read_regular(path, LARGEST + 1)
    if len(text) > LARGEST:
        raise ParametersError(f"{path}: is larger than {LARGEST >> 20} MiB; name a parameters file")
    try:
        document = json.loads(text, parse_constant=_refused)
        digest = document.pop("sha256", None)
        if digest is None:
            warnings.warn(f"{path}: has no checksum, so damage is not seen", UncheckedWarning, 2)
        elif digest != _digest(document):
            raise ParametersError(
                f"{path}: checksum does not match, so it is damaged; identify again, or remove the "
                "line sha256 if you changed the file yourself"
            )
        if document["format"] != FORMAT:
            raise ParametersError(f"{path}: has format {document['format']!r}; expected {FORMAT}")
        # Of this model; `Identified` checks parameters, units and inputs.
        about = document["model"]
        name = type(model).__name__
        if about["name"] != name or about["output"] != model.output:
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
    """SHA-256 of a document's content, whatever its layout."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _refused(constant: str) -> float:
    raise ValueError(f"holds {constant}")


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
