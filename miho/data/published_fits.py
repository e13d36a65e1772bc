"""Published regression problems: data, starts and optima as printed, in files of this package."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from miho.data.dataset import Dataset
from miho.validate import whole

FOLDER = Path(__file__).with_name("published")


@dataclass(frozen=True, eq=False)
class PublishedFit:
    """Data to which a model was fitted, and the fit, in the numbers of the publication.

    `title` says what it is and where it is from, `collection` is the set of problems it belongs to
    (nist, mgh, bw), `model` names the formula in `miho.models.PublishedModel`. `starts` are
    parameter rows to begin from, `optimum` is the best one, and `squares` its sum of squared
    residuals, to the digits published; `standard_errors` those of its parameters, where they were.
    """

    name: str
    title: str
    collection: str
    model: str
    starts: tuple[tuple[float, ...], ...]
    optimum: tuple[float, ...]
    squares: float
    dataset: Dataset
    standard_errors: tuple[float, ...] = ()


def published_names() -> tuple[str, ...]:
    """The names of all published problems, in alphabetical order."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.txt")))


def published_fit(name: str) -> PublishedFit:
    """The published problem `name`.

    A file holds the title, a line each for the collection, the model, the starts, the optimum, its
    standard errors if they were published, its sum of squares and the columns, the output first,
    then the rows. An output log(y) is the natural logarithm of what stands in the file. Columns
    have no units (-), as the models.
    """
    if name not in published_names():
        raise ValueError(f"name is {name!r}; choose from {', '.join(published_names())}")
    title, *lines = (FOLDER / f"{name}.txt").read_text(encoding="utf-8").splitlines()
    head = [line.split() for line in lines if line[0].isalpha()]
    rows = np.array([line.split() for line in lines[len(head) :]], dtype=float)
    fields = {key: values for key, *values in head}
    output, *inputs = fields["columns"]
    y = np.log(rows[:, 0]) if output == "log(y)" else rows[:, 0]
    columns = dict(zip(("y", *inputs), (y, *rows.T[1:]), strict=True))
    return PublishedFit(
        name=name,
        title=title,
        collection=fields["collection"][0],
        model=fields["model"][0],
        starts=tuple(tuple(map(float, values)) for key, *values in head if key == "start"),
        optimum=tuple(map(float, fields["optimum"])),
        squares=float(fields["squares"][0]),
        dataset=Dataset(name, columns, dict.fromkeys(columns, "-"), "y"),
        standard_errors=tuple(map(float, fields.get("errors", ()))),
    )


def load_published(name: str) -> Dataset:
    """The data of the published problem `name`: y over x, or over x1, x2, ..., without units."""
    return published_fit(name).dataset


def zero_residuals(rows: int) -> Dataset:
    """What a system of `rows` residuals is fitted to: y = 0 over `row`, from 1, without units.

    `miho.models.ResidualSystem` is the model of it. Raises ValueError for less than one row.
    """
    whole("rows", rows, 1)
    columns = {"y": np.zeros(rows), "row": np.arange(1.0, rows + 1)}
    return Dataset(f"zeros_{rows}", columns, dict.fromkeys(columns, "-"), "y")
