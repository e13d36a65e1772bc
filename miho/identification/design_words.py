"""The text of an experimental design: chosen rows, expected intervals, and assumptions."""

from __future__ import annotations

import math
from collections.abc import Hashable
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from miho.identification.flags import independence
from miho.identification.line_wrapping import with_unit
from miho.identification.report import Report
from miho.identification.validation import OR_DRIFT, in_a_sweep, is_finding
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.identification.experimental_design import Design

GAP = 0.1
"""Chosen values form two places if they differ by more than this fraction of the range of the
candidates."""
MOST_PLACES, MOST_QUANTITIES = 4, 3
"""The largest numbers of places and quantities that a sentence names."""
LINEAR = 0.5
"""The linearised model may mislead if a half width exceeds this fraction of the value."""
KILO = 1000.0


def advice(design: Design) -> str:
    """One or two sentences: the intervals that the chosen rows, or evenly spread rows, narrow."""
    table = design.table
    if design.goal:
        subject = table[table["quantity"] == design.goal]
    else:
        parameters = table[table["kind"] == "parameter"]
        ratio = parameters["expected half width"] / parameters["present half width"]
        order = ratio.fillna(1.0).sort_values(kind="stable").index
        subject = parameters.loc[order].head(MOST_QUANTITIES)
    records = subject.to_dict("records")
    words = f"{_what(design)} would narrow {', '.join(_narrowing(row) for row in records)}."
    first = records[0]
    if math.isfinite(first["evenly half width"]):
        even = _half_width(first, "evenly", in_percent=not math.isnan(first["evenly %"]))
        words += (
            " The same number of rows, spread evenly over all candidates, would narrow "
            f"{first['quantity']} to {even}."
        )
    return words


def assumptions(design: Design) -> list[str]:
    """Assumptions of the prediction, and quantities that stay undetermined; a sentence each."""
    report = design.report
    problem, at = report.problem, report.at
    sentences = [
        "this prediction assumes that the model is right, that new errors have the present "
        f"standard deviation ({with_unit(f'{at.noise:.3g}', problem.unit)}), and that the new "
        "optimum is near this one: measure, fit again, and plan again."
    ]
    if report.conclusion.doubt:
        sentences.append(
            f"the optimum is in doubt ({report.conclusion.doubt}): a better optimum would need "
            "other rows."
        )
    sentences += _undetermined(design)
    fixed = [problem.space.names[i] for i in np.flatnonzero(at.at_bound)]
    if fixed:
        sentences.append(f"fixed at a bound, and left out here: {', '.join(fixed)}.")
    table = design.table
    vague = table[(table["present half width"] > LINEAR * table["value"].abs())]
    vague = vague[np.isfinite(vague["present half width"]) & (vague["quantity"] == design.goal)]
    if len(vague):
        sentences.append(
            f"{design.goal} is so uncertain that the linearised prediction may mislead: measure "
            "some of these rows, and choose the others after the next fit."
        )
    if independence(problem, at, at):
        sentences.append(
            "the errors of the present rows are correlated, and new errors will be: rely on the "
            "factor by which the widths fall, not on the widths."
        )
    return sentences + _not_noise(report) + _beyond(design)


def table_text(design: Design) -> str:
    """The table of a design as text for a terminal."""
    rows = []
    for row in design.table.to_dict("records"):
        cells = {"": row["quantity"], "value": f"{row['value']:.4g}", "unit": row["unit"]}
        for state in ("present", "expected", "evenly"):
            half, percent = row[f"{state} half width"], row[f"{state} %"]
            cells[state] = "not determined" if math.isinf(half) else f"±{_two_digits(half)}"
            cells[f"{state} %"] = "" if math.isnan(percent) else f"±{_two_digits(percent)} %"
        rows.append(cells)
    level = f"half widths of {100 * design.report.level:g} % intervals"
    return f"{pd.DataFrame(rows).to_string(index=False)}\n({level})"


def _what(design: Design) -> str:
    """The number of chosen rows and their places."""
    inputs = design.report.problem.model.inputs
    varying = {name: unit for name, unit in inputs.items() if np.ptp(design.candidates[name]) > 0}
    places = places_of(design.chosen, design.candidates, varying or dict(inputs))
    count = len(design.chosen)
    rows = f"{count:,} row{'s' * (count != 1)}"
    if design.groups is not None:
        numbers = [f"{value:g}" if isinstance(value, float) else str(value)
                   for value in design.chosen[design.groups].unique()]  # fmt: skip
        return f"{rows} of {design.groups} {', '.join(numbers)}"
    if len(places) == 1:
        return f"{rows} at {places[0][1]}"
    named = [f"{number:,} at {place}" for number, place in places[:MOST_PLACES]]
    others = sum(number for number, _ in places[MOST_PLACES:])
    return f"{rows} ({'; '.join([*named, *([f'{others:,} elsewhere'] if others else [])])})"


def places_of(
    chosen: pd.DataFrame, candidates: pd.DataFrame, inputs: dict[str, str]
) -> list[tuple[int, str]]:
    """Number of chosen rows and ranges of the inputs at each place, the most rows first."""
    labels = pd.DataFrame(
        {name: _clusters(chosen[name].to_numpy(), candidates[name].to_numpy()) for name in inputs},
        index=chosen.index,
    )
    places = []
    for _, part in chosen.groupby([labels[name] for name in inputs], sort=True):
        ranges = [range_text(name, part[name].to_numpy(), unit) for name, unit in inputs.items()]
        places.append((len(part), ", ".join(ranges)))
    return sorted(places, key=lambda place: -place[0])


def _clusters(values: Array, candidates: Array) -> NDArray[np.intp]:
    """Cluster numbers (n,) of values, in ascending order."""
    levels, index = np.unique(values, return_inverse=True)
    cut = np.diff(levels, prepend=levels[0]) > GAP * np.ptp(candidates)
    return np.asarray(np.cumsum(cut)[index])


def range_text(name: str, values: Array, unit: str) -> str:
    """The range of a column as text, for example "alpha 4 to 7 deg"."""
    low, high = float(values.min()), float(values.max())
    if unit == "rad":
        low, high, unit = math.degrees(low), math.degrees(high), "deg"
    elif unit in ("N", "Pa") and max(abs(low), abs(high)) >= KILO:
        low, high, unit = low / KILO, high / KILO, f"k{unit}"
    ends = [f"{end:.3g}" for end in (low, high)]
    return with_unit(f"{name} {' to '.join(dict.fromkeys(ends))}", unit)


def _narrowing(row: dict[Hashable, Any]) -> str:
    """A quantity with its half widths before and after, in % if the value allows it."""
    name = row["quantity"]
    if math.isinf(row["expected half width"]):
        return f"{name} not at all"
    if math.isinf(row["present half width"]):
        after = _half_width(row, "expected", in_percent=not math.isnan(row["expected %"]))
        return f"{name}, which the present data do not determine, to {after}"
    in_percent = not math.isnan(row["present %"])
    before, after = (_half_width(row, state, in_percent) for state in ("present", "expected"))
    return f"{name} from {before} to {after}"


def _half_width(row: dict[Hashable, Any], state: str, in_percent: bool) -> str:
    if in_percent:
        return f"±{_two_digits(row[f'{state} %'])} %"
    return with_unit(f"±{_two_digits(row[f'{state} half width'])}", row["unit"])


def _two_digits(value: float) -> str:
    return f"{float(f'{value:.2g}'):g}"


def _undetermined(design: Design) -> list[str]:
    """Sentences on undetermined quantities: these rows, other candidates or none determine them."""
    table, none = design.table, design.undeterminable
    names = list(table["quantity"])
    now, after = (
        [
            name
            for name, half in zip(names, table[f"{state} half width"], strict=True)
            if np.isinf(half)
        ]
        for state in ("present", "expected")
    )
    closed = [name for name in now if name not in after]
    left = [name for name in now if name in after and name not in none]
    sentences = []
    if closed:
        sentences.append(
            f"the present data do not determine {', '.join(closed)}; these rows would."
        )
    if left:
        sentences.append(
            f"these rows would not determine {', '.join(left)}, but other candidates would: choose "
            "more rows, or rows for that goal."
        )
    if none:
        inputs = ", ".join(design.report.problem.model.inputs)
        sentences.append(
            f"no candidate determines {', '.join(none)}: even with all candidates, they can change "
            f"without changing any prediction. Add candidates with other values of {inputs}, or "
            "fix a parameter."
        )
    return sentences


def _not_noise(report: Report) -> list[str]:
    """A sentence if the errors follow a column: more rows do not average such errors out."""
    trends = report.trends.to_dict("records")
    strongest = max(trends, key=lambda row: row["explained"])
    if not is_finding(strongest["explained"], strongest["p"]):
        return []
    name = strongest["column"]
    share = f"{100 * strongest['explained']:.0f} % of the errors' variance follows {name}"
    if in_a_sweep(report.problem, name):
        drift = OR_DRIFT.format(name=name)
        return [f"{share}: the model does not allow for it, {drift} before you take more rows."]
    return [f"{share}: this part is not noise. Improve the model before you take more rows."]


def _beyond(design: Design) -> list[str]:
    """Sentences on chosen rows outside the ranges of the data."""
    problem = design.report.problem
    sentences = []
    for (name, unit), data in zip(problem.model.inputs.items(), problem.inputs, strict=True):
        values = design.chosen[name].to_numpy()
        outside = (values < data.min()) | (values > data.max())
        if outside.any():
            sentences.append(
                f"{np.count_nonzero(outside):,} of the rows lie beyond the data, which have "
                f"{range_text(name, data, unit)}: they do not show whether the model holds there."
            )
    return sentences
