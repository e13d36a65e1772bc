"""Published regression problems: data, starting points and optima, in the files of `data`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from miho.data.dataset import Dataset
from miho.validate import one_of, whole

FOLDER = Path(__file__).with_name("data")


@dataclass(frozen=True, eq=False)
class PublishedFit:
    """Data and the fit of a model, with the numbers of the publication.

    Attributes
    ----------
    name : str
        Name of the problem.
    title : str
        Description and source.
    collection : str
        The collection that contains the problem: nist, mgh, bw, r or dg.
    model : str
        The formula's name in `PublishedModel`.
    starts : tuple of tuple of float
        Starting points.
    optimum : tuple of float
        The best parameters.
    squares : float
        Sum of squared residuals at the optimum, to the published digits.
    dataset : Dataset
        The data.
    standard_errors : tuple of float
        Standard errors of the parameters, if published.
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
    """Names of all published problems, in alphabetical order.

    Returns
    -------
    tuple of str
        The names.

    Examples
    --------
    >>> from baselines.problems import published_names
    >>> published_names()[:3]
    ('bard', 'bennett5', 'biggs')
    """
    return tuple(sorted(path.stem for path in FOLDER.glob("*.txt")))


def published_fit(name: str) -> PublishedFit:
    """Return the published problem `name`.

    A file contains the title, one line each for the collection, the model, the starting points, the
    optimum, its standard errors if published, its sum of squares and the columns (output first),
    then the rows. An output log(y) is the natural logarithm of the values in the file. Columns and
    models have no units (-).

    Parameters
    ----------
    name : str
        One of `published_names`.

    Returns
    -------
    PublishedFit
        Data, starting points and optimum.

    Raises
    ------
    ValueError
        For an unknown name.

    Examples
    --------
    >>> from baselines.problems import published_fit
    >>> fit = published_fit("misra1a")
    >>> fit.optimum, len(fit.dataset)
    ((238.94212918, 0.00055015643181), 14)
    """
    one_of("name", name, published_names())
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
    """Data of a published problem: y over x, or over x1, x2, ..., without units.

    Parameters
    ----------
    name : str
        One of `published_names`.

    Returns
    -------
    Dataset
        The data.

    Raises
    ------
    ValueError
        For an unknown name.

    Examples
    --------
    >>> from baselines.problems import load_published
    >>> load_published("misra1a")
    <Dataset misra1a: 14 rows; columns: y [-], x [-]; output: y>
    """
    return published_fit(name).dataset


def zero_residuals(rows: int) -> Dataset:
    """Data of a system of residuals, whose model is `ResidualSystem`.

    Parameters
    ----------
    rows : int
        Number of residuals.

    Returns
    -------
    Dataset
        y = 0 over `row`, from 1, without units.

    Raises
    ------
    ValueError
        If `rows` is less than one.

    Examples
    --------
    >>> from baselines.problems import zero_residuals
    >>> zero_residuals(2)["row"].tolist()
    [1.0, 2.0]
    """
    whole("rows", rows, 1)
    columns = {"y": np.zeros(rows), "row": np.arange(1.0, rows + 1)}
    return Dataset(f"zeros_{rows}", columns, dict.fromkeys(columns, "-"), "y")
