"""Data for tire identification, drawn from a tire property file as in the paper (Sec. III, V-A.1).

The spread of the samples around a curve in the slip angle alone is not noise: it comes from load,
camber and slip ratio, which the curve ignores. `unmodelled_spread` measures it; no model of the
slip angle alone can have a smaller RMSE. `sample_lateral` keeps these conditions as columns, as a
tire test does, and `sample_axle` adds the two tires of an axle.
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

from miho.data.dataset import Dataset, file_name
from miho.quantities import Array
from miho.validate import at_least, one_of, whole
from miho.vehicle.models.magic_formula import MagicFormula
from miho.vehicle.models.tir import load_tir

Range = tuple[float, float]

_UNMODELLED = ("Fz", "gamma", "kappa")
AXLES = MappingProxyType({"front": ("lf", "rf"), "rear": ("lr", "rr")})
UNITS = {"alpha": "rad", "Fz": "N", "gamma": "rad", "kappa": "1", "Fy": "N"}
LATERAL_UNITS = {"alpha": "rad", "Fz": "N", "gamma": "rad", "pressure": "Pa", "Fy": "N"}


@dataclass(frozen=True, kw_only=True)
class SamplingRanges:
    """Bounds (low, high) between which each input is drawn uniformly and independently.

    Parameters
    ----------
    Fz : tuple of float
        Wheel load [N].
    gamma : tuple of float
        Camber [rad].
    alpha : tuple of float
        Slip angle [rad].
    kappa : tuple of float
        Slip ratio [1].
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
    """Loads within 20 % of the corner's load in a turn, camber within 1 deg of -lean [deg]."""
    return SamplingRanges(
        Fz=(0.8 * corner_load, 1.2 * corner_load),
        gamma=(radians(-lean - 1.0), radians(-lean + 1.0)),
    )


LOADS = (0.35, 0.7, 1.0, 1.5, 2.1)
PRESSURES = (0.85, 1.0, 1.15)
"""Loads and pressures of a test, relative to the nominal values."""

EMBEDDED_RANGES = MappingProxyType(
    {
        "lf": _oval(2610.0, 2.5),
        "rf": _oval(3900.0, 2.5),
        "lr": _oval(3000.0, 1.5),
        "rr": _oval(4500.0, 1.5),
    }
)
"""Sampling ranges of the four embedded tires: a left-turning oval car with higher outer loads.

All wheels lean to the left, into the turn. Camber as mechanics define it is positive on the left
and negative on the right; the inclination angle gamma of ISO-W is negative on both sides.
"""


def embedded_tire(name: str) -> Path:
    """Path of one of the embedded tire property files: lf, rf, lr or rr.

    Parameters
    ----------
    name : {'lf', 'rf', 'lr', 'rr'}
        The tire: left or right, front or rear.

    Returns
    -------
    Path
        Path of the file.

    Raises
    ------
    ValueError
        For another name.

    Examples
    --------
    >>> from miho.vehicle.data import embedded_tire
    >>> embedded_tire("lf").name
    'lf.tir'
    """
    if name not in EMBEDDED_RANGES:
        raise ValueError(f"no embedded tire {name!r}; choose from {', '.join(EMBEDDED_RANGES)}")
    return Path(str(resources.files("miho.vehicle.data") / "tires" / f"{name}.tir"))


def sample_tir(
    tire: str | os.PathLike[str],
    n: int = 3000,
    seed: int = 0,
    ranges: SamplingRanges | Mapping[str, Sequence[float] | None] | None = None,
    strict: bool = True,
) -> Dataset:
    """n samples of the lateral force of a tire at its nominal pressure and reference speed.

    Parameters
    ----------
    tire : path
        Name of an embedded tire (lf, rf, lr, rr) or path of a property file.
    n : int
        Number of samples.
    seed : int
        Seed of the samples.
    ranges : SamplingRanges or mapping, optional
        All ranges, or some by name. The defaults are `EMBEDDED_RANGES` for an embedded tire; for a
        file, loads within 20 % of FNOMIN and gamma within 1 deg of zero.
    strict : bool
        See `load_tir`.

    Returns
    -------
    Dataset
        Columns alpha [rad], Fz [N], gamma [rad], kappa [1] and the output Fy [N], ISO-W: positive
        alpha, negative Fy. The name is "tire_" and the embedded name or the file's stem.
    """
    rng = _generator(n, seed)
    formula, ranges, name = _resolve(tire, ranges, strict)
    columns = {key: ranges.draw(key, n, rng) for key in ("alpha", *_UNMODELLED)}
    columns["Fy"] = _lateral_force(formula, columns)
    return Dataset(name=f"tire_{name}", columns=columns, units=UNITS, output="Fy")


def sample_lateral(
    tire: str | os.PathLike[str],
    n: int = 3000,
    seed: int = 0,
    noise: float = 50.0,
    *,
    alpha: Sequence[float] = (-0.22, 0.22),
    loads: Sequence[float] | None = None,
    cambers: Sequence[float] = (-0.07, -0.035, 0.0, 0.035, 0.07),
    pressures: Sequence[float] | None = None,
    held_out: int = 1000,
    held_out_loads: Sequence[float] | None = None,
    held_out_cambers: Sequence[float] | None = None,
    strict: bool = True,
) -> Dataset:
    """n samples of pure lateral slip at the loads, cambers and pressures of a test, with noise.

    Parameters
    ----------
    tire : path
        See `sample_tir`.
    n : int
        Number of samples.
    seed : int
        Seed of the samples and the noise.
    noise : float
        Standard deviation of the normal noise of the force [N].
    alpha : sequence of float
        Bounds of the slip angle [rad], which is drawn uniformly.
    loads : sequence of float, optional
        Loads of the rows [N]; by default 0.35, 0.7, 1, 1.5 and 2.1 times FNOMIN.
    cambers : sequence of float
        Cambers of the rows [rad].
    pressures : sequence of float, optional
        Pressures of the rows [Pa]; by default 0.85, 1 and 1.15 times NOMPRES.
    held_out : int
        Number of rows in the dataset's `held_out`, measured at other loads and cambers.
    held_out_loads, held_out_cambers : sequence of float, optional
        Their loads [N] and cambers [rad]; by default halfway between neighbouring values.
    strict : bool
        See `load_tir`.

    Returns
    -------
    Dataset
        Columns alpha, Fz, gamma, pressure and the output Fy, ISO-W. The name is the name from
        `sample_tir` and "_conditions".
    """
    rng = _generator(n, seed)
    _generator(held_out, seed)
    at_least("noise", noise, 0)
    formula, bounds, name = _resolve(tire, {"alpha": alpha}, strict)
    p = formula.parameters
    levels = {
        "Fz": _levels("loads", [f * p.FNOMIN for f in LOADS] if loads is None else loads),
        "gamma": _levels("cambers", cambers),
        "pressure": _levels(
            "pressures", [f * p.NOMPRES for f in PRESSURES] if pressures is None else pressures
        ),
    }
    unseen = {
        "Fz": _unseen("held_out_loads", held_out_loads, levels["Fz"]),
        "gamma": _unseen("held_out_cambers", held_out_cambers, levels["gamma"]),
    }

    def measured(rows: int, at: dict[str, Array], held: Dataset | None) -> Dataset:
        columns = {"alpha": bounds.draw("alpha", rows, rng)}
        columns |= {key: rng.choice(values, rows) for key, values in at.items()}
        slip, Fz, gamma, pressure = columns.values()
        force = formula.forces(Fz, 0.0, slip, gamma, pressure=pressure).Fy
        columns["Fy"] = force + noise * rng.standard_normal(rows)
        suffix = "_conditions" if held else "_held_out"
        return Dataset(f"tire_{name}{suffix}", columns, LATERAL_UNITS, "Fy", held_out=held)

    return measured(n, levels, measured(held_out, levels | unseen, None))


def sample_axle(axle: str = "front", n: int = 3000, seed: int = 0) -> Dataset:
    """n samples of the lateral force of an axle with embedded tires: left plus right.

    Both wheels have the same slip angle. Each draws load, camber and slip ratio from its range in
    `EMBEDDED_RANGES`, as in `sample_tir`.

    Parameters
    ----------
    axle : {'front', 'rear'}
        The axle: tires lf and rf, or lr and rr.
    n : int
        Number of samples.
    seed : int
        Seed of the samples.

    Returns
    -------
    Dataset
        Columns alpha [rad], Fz_left, Fz_right [N], gamma_left, gamma_right [rad], kappa_left,
        kappa_right [1] and the output Fy [N], ISO-W. The name is the axle and "_axle".

    Raises
    ------
    ValueError
        For another axle or an invalid number or seed.
    """
    one_of("axle", axle, AXLES)
    rng = _generator(n, seed)
    columns = {"alpha": EMBEDDED_RANGES[AXLES[axle][0]].draw("alpha", n, rng)}
    units, Fy = {"alpha": "rad", "Fy": "N"}, np.zeros(n)
    for side, tire in zip(("left", "right"), AXLES[axle], strict=True):
        own = {key: EMBEDDED_RANGES[tire].draw(key, n, rng) for key in _UNMODELLED}
        Fy += _lateral_force(load_tir(embedded_tire(tire)), own | {"alpha": columns["alpha"]})
        columns |= {f"{key}_{side}": values for key, values in own.items()}
        units |= {f"{key}_{side}": UNITS[key] for key in own}
    return Dataset(f"{axle}_axle", columns | {"Fy": Fy}, units, "Fy")


def unmodelled_spread(
    tire: str | os.PathLike[str],
    ranges: SamplingRanges | None = None,
    n: int = 1000,
    redraws: int = 400,
    seed: int | np.random.Generator = 0,
) -> float:
    """Smallest RMSE [N] of any curve in alpha: sqrt(E[Var(Fy | alpha)]) over the sampling ranges.

    Parameters
    ----------
    tire, ranges
        See `sample_tir`.
    n : int
        Number of slip angles.
    redraws : int
        Draws of the other inputs for each slip angle, of which the unbiased variance is taken.
    seed : int or Generator
        Seed of the Monte Carlo estimate.

    Returns
    -------
    float
        The RMSE [N].
    """
    if n < 1 or redraws < 2:
        raise ValueError(f"n is {n} and redraws {redraws}; at least 1 and 2 are needed")
    formula, ranges, _ = _resolve(tire, ranges)
    rng = np.random.default_rng(seed)
    inputs = {"alpha": ranges.draw("alpha", (n, 1), rng)}
    inputs |= {key: ranges.draw(key, (n, redraws), rng) for key in _UNMODELLED}
    Fy = _lateral_force(formula, inputs)
    return float(np.sqrt(Fy.var(axis=1, ddof=1).mean()))


def _generator(n: int, seed: int) -> np.random.Generator:
    if n < 1:
        raise ValueError(f"n is {n}; at least one sample is needed")
    whole("seed", seed, 0)
    return np.random.default_rng(seed)


def _levels(name: str, values: Sequence[float]) -> Array:
    levels = np.array(values, dtype=float)
    if not levels.size or not np.isfinite(levels).all():
        raise ValueError(f"{name} is {list(values)}; give finite numbers, at least one")
    return np.unique(levels)


def _unseen(name: str, values: Sequence[float] | None, training: Array) -> Array:
    """Levels that no training row has; by default halfway between the training levels."""
    if values is None:
        return (training[1:] + training[:-1]) / 2 if training.size > 1 else training
    levels = _levels(name, values)
    if np.isin(levels, training).any():
        raise ValueError(f"{name} is {list(values)}; expected levels that the training data lack")
    return levels


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
        default = _oval(formula.parameters.FNOMIN, 0.0)
    if isinstance(ranges, SamplingRanges):
        return formula, ranges, name
    if ranges is not None and not isinstance(ranges, Mapping):
        raise ValueError(f"ranges is {ranges!r}; map names of inputs to their bounds")
    chosen = {key: bounds for key, bounds in (ranges or {}).items() if bounds is not None}
    for key, bounds in chosen.items():
        if key not in UNITS or key == "Fy" or not isinstance(bounds, Sequence) or len(bounds) != 2:
            raise ValueError(
                f"sampling range {key}: {bounds}; name one of Fz, gamma, alpha, kappa and "
                "give its lower and upper bound"
            )
    pairs = {key: (float(bounds[0]), float(bounds[1])) for key, bounds in chosen.items()}
    return formula, replace(default, **pairs), name
