"""The layout of a measurement file: units, signs, plausible magnitudes and held-out rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from miho.data.conventions import FLIPPED, conventions_of, sign_problem, to_iso_w
from miho.data.dataset import Dataset, number_pair
from miho.data.preview import Reading
from miho.quantities import Array
from miho.units import UNITS, Unit, si
from miho.validate import one_of, whole

Fault = Callable[[str, int | None, str], ValueError]
"""Makes the error about a header and a row of the file, counted from 0 (None: the whole column)."""

PLAUSIBLE: Mapping[str, tuple[str, float, float]] = MappingProxyType(
    {
        "alpha": ("rad", 0.01, 1.0),
        "gamma": ("rad", 0.002, 1.2),
        "kappa": ("-", 0.003, 2.0),
        "Fx": ("N", 15.0, 6e4),
        "Fy": ("N", 15.0, 6e4),
        "Fz": ("N", 20.0, 8e4),
        "Mx": ("Nm", 3.0, 1e4),
        "Mz": ("Nm", 1.0, 2e3),
        "pressure": ("Pa", 2e4, 2e6),
        "vx": ("m/s", 0.5, 120.0),
        "Vx": ("m/s", 0.5, 120.0),
        "ax": ("m/s^2", 0.3, 100.0),
        "ay": ("m/s^2", 0.3, 100.0),
        "yaw_rate": ("rad/s", 0.01, 10.0),
        "omega": ("rad/s", 5.0, 2500.0),
    }
)
"""Unit and range of the largest magnitude of a column, for any car or motorcycle.

The lower bounds are as large as possible without refusing real tests. A column in rad that was
declared in deg, or in kN declared in N, falls below them.
"""
ZERO_IN_SOME_TESTS = frozenset({"alpha", "gamma", "kappa"})
"""Inputs that a test may keep at zero: such a column is refused only if it fits another unit."""
FRICTION = 5.0
"""Upper bound of the largest force over the largest load, for any tire and surface."""


def check_columns(
    columns: Sequence[str], units: Sequence[str], headers: Sequence[str], flip: Sequence[str]
) -> None:
    """Refuse columns of a file without a name, a unit and a header each, and unknown units.

    Raises ValueError with the setting and its value.
    """
    settings = {"columns": columns, "units": units, "headers": headers, "flip": flip}
    for setting, names in settings.items():
        listed = isinstance(names, Sequence) and not isinstance(names, str)
        if not (listed and all(isinstance(name, str) for name in names)):
            raise ValueError(f"{setting} is {names!r}; give a list of names")
        if setting != "units" and len(set(names)) != len(names):
            raise ValueError(f"{setting} is {list(names)}; name each once")
    if not columns or not len(columns) == len(units) == len(headers):
        raise ValueError(
            f"{len(columns)} columns, {len(units)} units and {len(headers)} headers; give one unit "
            "per column, and one header per column or none"
        )
    check_names("flip", flip, columns)
    for unit in units:
        si(unit)


def check_names(setting: str, names: Iterable[str], columns: Sequence[str]) -> None:
    """Raise ValueError if a setting names something that is not a column."""
    for name in names:
        if name not in columns:
            raise ValueError(
                f"{setting} names {name!r}; columns are {', '.join(columns)}; choose one of them"
            )


@dataclass(frozen=True)
class Layout:
    """The columns of a file and their conversion to a dataset; the settings of the loaders.

    Parameters
    ----------
    columns : sequence of str
        Names of the columns in the model. A column that is neither an input of the model nor the
        `output` is a condition.
    units : sequence of str
        Units of the columns in the file, in the same order (see `miho.units`).
    output : str
        Name of the output column.
    headers : sequence of str, optional
        Names of the columns in the file, in the same order, if they differ.
    convention : str
        Sign convention of the file, see `miho.data.conventions`.
    flip : sequence of str
        Columns whose sign is changed once more.
    ranges : mapping, optional
        Bounds of the largest magnitude of a column in SI units, instead of `PLAUSIBLE`; None
        disables the check.
    held_out : mapping, optional
        Rows held out for validation, as ranges of columns in SI units and ISO-W signs
        (`Dataset.hold_out`).
    where : mapping, optional
        Rows to use, as ranges of columns in the file's names, units and signs. A row must lie in
        all of them.
    every : int
        Keep the first of every `every` of these rows.

    Raises
    ------
    ValueError
        For an invalid setting.
    """

    columns: Sequence[str]
    units: Sequence[str]
    output: str
    headers: Sequence[str] | None = None
    convention: str = "iso-w"
    flip: Sequence[str] = ()
    ranges: Mapping[str, Sequence[float] | None] | None = None
    held_out: Mapping[str, Sequence[float]] | None = None
    where: Mapping[str, Sequence[float]] | None = None
    every: int = 1

    def __post_init__(self) -> None:
        headers = self.columns if self.headers is None else self.headers
        check_columns(self.columns, self.units, headers, self.flip)
        one_of("convention", self.convention, FLIPPED)
        whole("every", self.every, 1)
        # Mappings map existing columns to pairs of bounds.
        for setting in ("ranges", "held_out", "where"):
            if not isinstance(getattr(self, setting) or {}, Mapping):
                raise ValueError(
                    f"{setting} is {getattr(self, setting)!r}; map columns to their bounds, "
                    "for example {Fz: [3900, 4100]}"
                )
        settings = {
            "output": [self.output], "ranges": self.ranges or {}, "held_out": self.held_out or {},
        }  # fmt: skip
        for setting, names in settings.items():
            check_names(setting, names, self.columns)
        for name, bounds in (self.ranges or {}).items():
            if bounds is not None:
                number_pair(bounds, f"the range of {name}")
        where = {}
        for name, bounds in (self.where or {}).items():
            number_pair(bounds, f"where {name}")
            key = name.strip() if isinstance(name, str) else ""  # as in the header line
            if not key or key in where:
                raise ValueError(f"where names {name!r}; name columns of the file, each once")
            where[key] = bounds
        object.__setattr__(self, "where", where or None)

    @property
    def names(self) -> Sequence[str]:
        """Names of the columns in the file."""
        if self.headers is None:
            return self.columns
        return [header.strip() for header in self.headers]  # as in the header line

    @property
    def _header(self) -> dict[str, str]:
        """Names of the columns in the file, by their names in the dataset."""
        return dict(zip(self.columns, self.names, strict=True))

    @property
    def all_names(self) -> list[str]:
        """Names of all columns to read, including the columns of `where`."""
        return list(dict.fromkeys([*self.names, *(self.where or {})]))

    def dataset(
        self, name: str, path: str, all_numbers: Mapping[str, Array], file_fault: Fault,
        notes: Sequence[str] = (),
    ) -> Dataset:  # fmt: skip
        """The dataset of a file's columns (N,), which are given by the names in `all_names`.

        `notes` are phrases on how the file was read. `file_fault` makes the error that is raised
        for numbers that cannot have the declared unit or sign.
        """
        rows = self._rows(path, all_numbers)
        numbers = {key: column[rows] for key, column in all_numbers.items()}

        def fault(header: str, row: int | None, problem: str) -> ValueError:
            return file_fault(header, None if row is None else int(rows[row]), problem)

        columns, units = self.si_columns(numbers, fault, all_numbers)
        # The output and at least one other column must vary.
        constant = [key for key, column in columns.items() if np.ptp(column) == 0]
        if self.output in constant or len(constant) >= max(1, len(columns) - 1):
            key = self.output if self.output in constant else constant[0]
            problem = f"column {self._header[key]!r} has the same value in every row"
            remedy = "choose one that varies: nothing can be identified from this one"
            raise fault(self._header[key], None, f"{problem}; {remedy}")
        file_columns = {key: all_numbers[key] for key in self.names}
        where = (self.where or {}).items()
        chosen = [f"{key} from {low:g} to {high:g}" for key, (low, high) in where]
        chosen += [f"one of every {self.every} rows"] if self.every > 1 else []
        reading = Reading.of(path, file_columns, self.units, [*notes, *chosen])
        dataset = Dataset(name, columns, units, self.output, reading=reading)
        return dataset.hold_out(self.held_out) if self.held_out else dataset

    def si_columns(
        self,
        numbers: Mapping[str, Array],
        fault: Fault,
        all_numbers: Mapping[str, Array] | None = None,
    ) -> tuple[dict[str, Array], dict[str, str]]:
        """The columns (n,) and their units, from the file's numbers by its names.

        Columns are in SI units and ISO-W signs. An implausible magnitude or sign raises the error
        that `fault` makes. `all_numbers` are the columns (N,) before rows were selected, which show
        the unit better.
        """
        columns, units = self.sized_columns(numbers, fault, all_numbers)
        wrong = sign_problem(columns, units)
        if wrong is not None:
            remedies = [f"convention={name}" for name in
                        conventions_of(columns, units, self.convention)]  # fmt: skip
            flips = (sorted({*self.flip} ^ {name}) for name in wrong.negated)
            remedies += [f"flip=[{', '.join(names)}]" for names in flips]
            raise fault(
                self._header[wrong.column], None, f"{wrong.problem}; set {' or '.join(remedies)}"
            )
        return columns, units

    def sized_columns(
        self,
        numbers: Mapping[str, Array],
        fault: Fault,
        all_numbers: Mapping[str, Array] | None = None,
    ) -> tuple[dict[str, Array], dict[str, str]]:
        """The columns and their units as by `si_columns`, whatever their signs are."""
        columns, units = {}, {}
        for key, spelling in zip(self.columns, self.units, strict=True):
            unit, raw = si(spelling), numbers[self._header[key]]
            with np.errstate(over="ignore"):
                columns[key], units[key] = raw * unit.factor, unit.name
            self._check_size(key, unit, raw, (all_numbers or numbers)[self._header[key]], fault)
        self._check_friction(columns, units, fault)
        return to_iso_w(columns, self.convention, self.flip), units

    def _rows(self, path: str, numbers: Mapping[str, Array]) -> NDArray[np.intp]:
        """Rows (n,) that `where` and `every` select."""
        inside = np.ones(next(iter(numbers.values())).size, dtype=bool)
        for key, bounds in (self.where or {}).items():
            low, high = number_pair(bounds, f"where {key}")
            inside &= (numbers[key] >= low) & (numbers[key] <= high)
        if not inside.any():
            spans = ", ".join(
                f"{key} from {numbers[key].min():g} to {numbers[key].max():g}"
                for key in self.where or {}
            )
            raise ValueError(
                f"{path}: no row has where={dict(self.where or {})}; in the file's units, the "
                f"data have {spans}; widen the ranges"
            )
        return np.flatnonzero(inside)[:: self.every]

    def _check_size(self, key: str, unit: Unit, raw: Array, all_raw: Array, fault: Fault) -> None:
        """Refuse a column (n,) in the file's unit whose magnitude is implausible.

        A single cell may be too large. The unit is judged by all rows of the file (N,): the largest
        must not be too small, and most must not be too large.
        """
        header = self._header[key]
        low, high = self._plausible(key, unit)
        sizes, row = np.abs(all_raw), int(np.argmax(np.abs(raw)))
        with np.errstate(over="ignore"):
            largest, of_all = (float(size) * unit.factor for size in (abs(raw[row]), sizes.max()))
            if not np.isfinite(largest):
                problem = f"{raw[row]:g} is not finite in {unit.name}; correct the cell"
                raise fault(header, row, problem)
            stated = key in (self.ranges or {})
            if low <= largest <= high and (stated or of_all <= high):
                return
            typical = float(np.median(sizes)) * unit.factor
        if low <= largest <= high and typical <= high:
            return
        size, label = (of_all, "largest") if typical <= high else (typical, "median")
        if largest > high:
            size, label = largest, "largest"
        if size == 0 or low <= size <= high:
            return
        fitting = [
            spelling
            for spelling, other in UNITS.items()
            if other.name == unit.name and low <= size / unit.factor * other.factor <= high
        ]
        if size < low and key in ZERO_IN_SOME_TESTS and not (fitting or stated):
            return
        units = " or ".join(fitting).replace(" or ", ", ", max(len(fitting) - 2, 0))
        doubt = f"is the column in {units}?" if fitting else "is this cell right?"
        unit_name = "" if unit.name == "-" else f" {unit.name}"
        raise fault(
            header, row if size == largest else None,
            f"{label} |{key}| is {size:.4g}{unit_name}, expected {low:g} to {high:g}; {doubt} "
            f"Correct it, or set ranges={{{key}: [from, to]}}",
        )  # fmt: skip

    def _check_friction(
        self, columns: Mapping[str, Array], units: Mapping[str, str], fault: Fault
    ) -> None:
        """Refuse forces that no load can cause: one of the two columns has another unit."""
        for key in ("Fx", "Fy"):
            stated = {key, "Fz"} & (self.ranges or {}).keys()
            if stated or not units.get(key) == units.get("Fz") == "N":
                continue
            force, load = (float(np.abs(columns[name]).max()) for name in (key, "Fz"))
            if force > FRICTION * load > 0:
                raise fault(
                    self._header[key], None,
                    f"largest |{key}| is {force / load:.3g} times the largest |Fz|, expected at "
                    f"most {FRICTION:g} times; correct the unit of one of them, or set "
                    f"ranges={{{key}: [from, to]}}",
                )  # fmt: skip

    def _plausible(self, key: str, unit: Unit) -> Sequence[float]:
        """Bounds of the largest magnitude of a column, in SI units."""
        bounds: Sequence[float] | None = None
        si_unit, *default = PLAUSIBLE.get(key, ("", 0.0, 0.0))
        if si_unit == unit.name:
            bounds = default
        if self.ranges is not None and key in self.ranges:
            bounds = self.ranges[key]
        return (0.0, np.inf) if bounds is None else bounds
