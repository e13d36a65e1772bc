"""Data for tire identification, drawn from a property file as in the paper (Sec. III, V-A.1).

The spread of the samples around a curve in the slip angle alone is not noise: it is the load,
camber and slip ratio the curve does not see. `unmodelled_spread` measures it, and no model of
the slip angle alone can have a smaller RMSE.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from math import radians
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from miho.data.dataset import Dataset, file_name
from miho.models.magic_formula import MagicFormula
from miho.models.tir import load_tir

Array = NDArray[np.float64]
Range = tuple[float, float]

_UNMODELLED = ("Fz", "gamma", "kappa")
UNITS = {"alpha": "rad", "Fz": "N", "gamma": "rad", "kappa": "1", "Fy": "N"}


@dataclass(frozen=True, kw_only=True)
class SamplingRanges:
    """Bounds (low, high) between which each input is drawn uniformly and independently.

    Fz: wheel load [N]. gamma: camber [rad]. alpha: slip angle [rad]. kappa: slip ratio [1].
    """

    Fz: Range
    gamma: Range
    alpha: Range = (-0.22, 0.22)
    kappa: Range = (-0.025, 0.025)

    def __post_init__(self) -> None:
        for name in ("Fz", "gamma", "alpha", "kappa"):
            low, high = getattr(self, name)
            if not (np.isfinite([low, high]).all() and low <= high):
                raise ValueError(
                    f"sampling range of {name} is ({low}, {high}); give two finite numbers, "
                    f"the lower first"
                )

    def draw(self, name: str, shape: int | tuple[int, ...], rng: np.random.Generator) -> Array:
        """Values of one input, uniform between its bounds, of the given shape."""
        low, high = getattr(self, name)
        return rng.uniform(low, high, shape)


def _oval(corner_load: float, lean: float) -> SamplingRanges:
    """Load within 20 % of what the corner carries in a turn, lean [deg] within 1 deg."""
    return SamplingRanges(
        Fz=(0.8 * corner_load, 1.2 * corner_load),
        gamma=(radians(-lean - 1.0), radians(-lean + 1.0)),
    )


EMBEDDED_RANGES = MappingProxyType(
    {
        "lf": _oval(2610.0, 2.5),
        "rf": _oval(3900.0, 2.5),
        "lr": _oval(3000.0, 1.5),
        "rr": _oval(4500.0, 1.5),
    }
)
"""Where the four embedded tires are sampled: a left-turning oval car, outer wheels loaded more.

All wheels lean to the left, into the turn: camber as a mechanic counts it is positive on the left
and negative on the right, and the inclination angle gamma of ISO-W is negative on both sides.
"""


def embedded_tire(name: str) -> Path:
    """Path of one of the project's own property files: lf, rf, lr or rr."""
    if name not in EMBEDDED_RANGES:
        raise ValueError(f"no embedded tire {name!r}; choose from {', '.join(EMBEDDED_RANGES)}")
    return Path(str(resources.files("miho.data") / "tires" / f"{name}.tir"))


def sample_tir(
    tire: str | os.PathLike[str],
    n: int = 3000,
    seed: int = 0,
    ranges: SamplingRanges | Mapping[str, Sequence[float] | None] | None = None,
    strict: bool = True,
) -> Dataset:
    """n samples of the lateral force of a tire at its nominal pressure and reference speed.

    tire: an embedded name (lf, rf, lr, rr) or the path of a property file. ranges: all of them, or
    some by name; the others are those of `EMBEDDED_RANGES` for an embedded tire, and for a file
    loads within 20 % of FNOMIN and gamma within 1 deg of zero. Columns alpha [rad], Fz [N],
    gamma [rad], kappa [1] and the output Fy [N], ISO-W: positive alpha, negative Fy. The name is
    "tire_" and the embedded name or the file's stem. `strict` is that of `load_tir`.
    """
    if n < 1:
        raise ValueError(f"n is {n}; at least one sample is needed")
    if seed < 0:
        raise ValueError(f"seed is {seed}; expected a whole number of at least 0")
    formula, ranges, name = _resolve(tire, ranges, strict)
    rng = np.random.default_rng(seed)
    columns = {key: ranges.draw(key, n, rng) for key in ("alpha", *_UNMODELLED)}
    columns["Fy"] = _lateral_force(formula, columns)
    return Dataset(name=f"tire_{name}", columns=columns, units=UNITS, output="Fy")


def unmodelled_spread(
    tire: str | os.PathLike[str],
    ranges: SamplingRanges | None = None,
    n: int = 1000,
    redraws: int = 400,
    seed: int | np.random.Generator = 0,
) -> float:
    """sqrt(E[Var(Fy | alpha)]) [N] over the sampling ranges: the RMSE no curve in alpha undercuts.

    Monte Carlo: for each of n slip angles the other inputs are drawn anew `redraws` times; the
    variance is the unbiased one. Arguments as in `sample_tir`.
    """
    if n < 1 or redraws < 2:
        raise ValueError(f"n is {n} and redraws {redraws}; at least 1 and 2 are needed")
    formula, ranges, _ = _resolve(tire, ranges)
    rng = np.random.default_rng(seed)
    inputs = {"alpha": ranges.draw("alpha", (n, 1), rng)}
    inputs |= {key: ranges.draw(key, (n, redraws), rng) for key in _UNMODELLED}
    Fy = _lateral_force(formula, inputs)
    return float(np.sqrt(Fy.var(axis=1, ddof=1).mean()))


def _lateral_force(formula: MagicFormula, inputs: dict[str, Array]) -> Array:
    return formula.forces(inputs["Fz"], inputs["kappa"], inputs["alpha"], inputs["gamma"]).Fy


def _resolve(
    tire: str | os.PathLike[str],
    ranges: SamplingRanges | Mapping[str, Sequence[float] | None] | None,
    strict: bool = True,
) -> tuple[MagicFormula, SamplingRanges, str]:
    if isinstance(tire, str) and tire in EMBEDDED_RANGES:
        formula, name, default = load_tir(embedded_tire(tire)), tire, EMBEDDED_RANGES[tire]
    else:
        formula, name = load_tir(tire, strict), file_name(tire)
        FNOMIN = formula.parameters.FNOMIN
        default = SamplingRanges(Fz=(0.8 * FNOMIN, 1.2 * FNOMIN), gamma=(-radians(1), radians(1)))
    if isinstance(ranges, SamplingRanges):
        return formula, ranges, name
    if ranges is not None and not isinstance(ranges, Mapping):
        raise ValueError(f"ranges is {ranges!r}; map names of inputs to their bounds")
    given = {key: bounds for key, bounds in (ranges or {}).items() if bounds is not None}
    for key, bounds in given.items():
        if key not in UNITS or key == "Fy" or not isinstance(bounds, Sequence) or len(bounds) != 2:
            raise ValueError(
                f"sampling range {key}: {bounds}; name one of Fz, gamma, alpha, kappa and "
                "give its lower and upper bound"
            )
    pairs = {key: (float(bounds[0]), float(bounds[1])) for key, bounds in given.items()}
    return formula, replace(default, **pairs), name
