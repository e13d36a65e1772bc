"""Model of a tire from a property file: force over slip, load and camber, also for `miho.fit`."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from miho.models.derived import Derived
from miho.models.symbolic import Symbol, constant, trace
from miho.models.traced import TracedExpression
from miho.optim import Space
from miho.quantities import Array
from miho.vehicle.models.features import tire_features
from miho.vehicle.models.iso_w import check_iso_w, in_iso_w
from miho.vehicle.models.lateral_magic_formula import COEFFICIENTS
from miho.vehicle.models.magic_formula import MagicFormula
from miho.vehicle.models.magic_formula_parameters import parameter_names
from miho.vehicle.models.tir import load_tir, write_tir
from miho.vehicle.models.tir_format import SECTION_OF
from miho.vehicle.models.tir_reader import PropertyFile, read_tir

OUTPUTS = {"Fx": "N", "Fy": "N", "Mz": "N*m"}
INPUTS = {
    "kappa": "1", "alpha": "rad", "Fz": "N", "gamma": "rad", "Vx": "m/s", "pressure": "Pa",
}  # fmt: skip


@dataclass(frozen=True)
class TireFormula(TracedExpression):
    """Fx, Fy [N] or Mz [Nm] of a `MagicFormula` of any version, over some of its inputs.

    Derivatives are exact. At kinks, for example at the limit E = 1, they are one-sided.

    Parameters
    ----------
    tire : MagicFormula
        The tire, which gives the values of all other coefficients.
    coefficients : tuple of str
        Coefficients that are parameters, with their names in property files.
    force : {"Fx", "Fy", "Mz"}, optional
        The output.
    columns_of : tuple of str, optional
        The inputs, in SI units and ISO-W signs: alpha [rad], Fz [N], kappa [1], gamma [rad],
        Vx [m/s], pressure [Pa]. By default, kappa and gamma are 0, and Vx and pressure have the
        values LONGVL and NOMPRES of the tire.
    source : Path, optional
        Property file of the tire.

    Raises
    ------
    ValueError
        If a coefficient, the force or an input is unknown, or if Fz or both slips are missing.

    References
    ----------
    Pacejka, Tire and Vehicle Dynamics, 3rd ed. (2012), Sec. 4.3.2.
    """

    tire: MagicFormula
    coefficients: tuple[str, ...]
    force: str = "Fy"
    columns_of: tuple[str, ...] = ("alpha", "Fz")
    source: Path | None = None

    def __post_init__(self) -> None:
        version = self.tire.parameters.version
        if not self.coefficients:
            raise ValueError(
                "coefficients is empty; name the coefficients to fit, for example PDY1"
            )
        for name in self.coefficients:
            known = name in parameter_names(version) and is_coefficient(name)
            if not known or self.coefficients.count(name) > 1:
                raise ValueError(
                    f"coefficients has {name!r}, which is given twice or not a coefficient of MF "
                    f"{version}; use names of property files, for example PDY1"
                )
        if self.force not in OUTPUTS:
            raise ValueError(f"the output is {self.force!r}; expected {', '.join(OUTPUTS)}")
        if "Fz" not in self.columns_of or not {"alpha", "kappa"} & {*self.columns_of}:
            raise ValueError(
                f"the inputs are {', '.join(self.columns_of) or 'none'}; expected at least Fz [N] "
                "and either alpha [rad] or kappa [1]"
            )

    @cached_property
    def graph(self) -> Symbol:
        """Graph of the force; raises NotAFormulaError if it cannot be traced."""
        return trace(self._force)

    def _force(self) -> Any:
        p = self.tire.parameters
        chosen = dict(zip(self.coefficients, self.arguments, strict=True))
        tire = replace(self.tire, parameters=cast(Any, SimpleNamespace(**(vars(p) | chosen))))
        usual = {"kappa": 0.0, "alpha": 0.0, "gamma": 0.0, "Vx": p.LONGVL, "pressure": p.NOMPRES}
        measured = dict(zip(self.inputs, self.columns, strict=True))
        at: dict[str, Any] = {name: constant(value) for name, value in usual.items()} | measured
        return getattr(tire.forces_at(tire.conditions(**at)), self.force)

    @property
    def linear(self) -> tuple[str, ...]:
        """The coefficients in which the force is jointly linear."""
        return self.jointly_linear

    @property
    def inputs(self) -> Mapping[str, str]:
        """The input columns with their units."""
        return {name: INPUTS[name] for name in self.columns_of}

    @property
    def parameters(self) -> Mapping[str, str]:
        """The coefficients with their units, "" if unknown."""
        return {name: COEFFICIENTS.get(name, "") for name in self.coefficients}

    @property
    def output(self) -> str:
        """The unit of the force or moment."""
        return OUTPUTS[self.force]

    @property
    def name(self) -> str:
        """Name of the force, after the name of the file if there is one."""
        return self.force if self.source is None else f"{self.source.stem}_{self.force}"

    def derived_quantities(self, columns: Mapping[str, Array]) -> tuple[Derived, ...]:
        """Return stiffness, peaks and friction of a force [N] over the slip angle."""
        over_alpha = next(iter(self.inputs)) == "alpha" and self.output == "N"
        return tire_features(self, columns) if over_alpha else ()

    def own_values(self) -> dict[str, float]:
        """Return the values of the coefficients in the tire."""
        return {name: getattr(self.tire.parameters, name) for name in self.coefficients}

    def check_data(
        self,
        inputs: Mapping[str, Array],
        output: Array,
        convention: str,
        ranges: Mapping[str, Sequence[float] | None] | None,
        largest: Mapping[str, float],
    ) -> None:
        """Raise ValueError if the size or the sign of a column (N,) is impossible for a tire.

        All columns are in SI units. `miho.data.measurements.Layout` documents `convention` and
        `ranges`.
        """
        units = [*self.inputs.values(), self.output.replace("*", "")]
        check_iso_w(inputs, units, self.force, output, convention, ranges)

    def converted(
        self, inputs: Mapping[str, Array], output: Array, convention: str
    ) -> tuple[dict[str, Array], Array]:
        """Return inputs and force (N,) in ISO-W signs."""
        return in_iso_w(inputs, self.force, output, convention)

    def check_signs(self, inputs: Mapping[str, Array]) -> None:
        """Raise ValueError if most loads Fz are negative."""
        if np.median(inputs["Fz"]) < 0:
            raise ValueError("Fz is mostly negative; predict takes a tire's inputs in ISO-W signs")

    def write(self, values: Mapping[str, float], path: str | os.PathLike[str]) -> None:
        """Write the property file with new values of the coefficients; the rest is unchanged."""
        own: dict[str, Any] = {name: float(values[name]) for name in self.coefficients}
        written = replace(self.tire, parameters=replace(self.tire.parameters, **own))
        if self.source is None:
            write_tir(written, path)
            return
        file = read_tir(self.source)
        sections = {name: dict(entries) for name, entries in file.sections.items()}
        for name, value in own.items():
            sections.setdefault(SECTION_OF[name], {})[name] = value
        write_tir(PropertyFile(sections, file.tables), path)


def tire_formula(
    tire: MagicFormula | str | os.PathLike[str],
    coefficients: Collection[str],
    columns: Collection[str],
    force: str,
) -> TireFormula:
    """Return the model of a tire or property file; its inputs are the known names in `columns`."""
    formula, source = (
        (tire, None) if isinstance(tire, MagicFormula) else (load_tir(tire), Path(tire))
    )
    inputs = tuple(name for name in INPUTS if name in columns)
    return TireFormula(formula, tuple(coefficients), force, inputs, source)


def is_coefficient(name: str) -> bool:
    """Return whether a name is a coefficient of the equations, not a nominal value or range."""
    return SECTION_OF.get(name, "").endswith("_COEFFICIENTS")


def tire_model(
    tire: MagicFormula | str | os.PathLike[str],
    x: Any,
    y: Any,
    space: Space | Mapping[str, Any] | Collection[str],
    start: Mapping[str, float] | None,
    fixed: Mapping[str, float],
    tied: Mapping[str, str],
) -> tuple[TireFormula, Space | Mapping[str, Any] | None, Mapping[str, float] | None]:
    """Return the model of a tire or of its file, with bounds and start, as `miho.fit` needs them.

    A coefficient that is only named starts at the value of the tire. If coefficients are tied, the
    space may have parameters that are not coefficients.
    """
    if not isinstance(y, str) or not (isinstance(x, Mapping) or hasattr(x, "columns")):
        raise ValueError(
            "x and y of a tire: expected columns by name as x and the name of one of them, Fx, Fy "
            "or Mz, as y"
        )
    space = [space] if isinstance(space, str) else space
    bounded = isinstance(space, Space | Mapping)
    named = space.names if isinstance(space, Space) else tuple(space)
    extra = {name for name in named if bounded and tied and not is_coefficient(name)}
    names = dict.fromkeys([*named, *(start or ()), *fixed, *tied])
    model = tire_formula(tire, [name for name in names if name not in extra], [*x], y)
    if isinstance(space, Space | Mapping):
        return model, space, start
    own = model.own_values()
    return model, None, {name: own[name] for name in named} | dict(start or {})
