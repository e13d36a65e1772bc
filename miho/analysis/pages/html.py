"""HTML from templates: all values are escaped, and a page loads nothing."""

from __future__ import annotations

import base64
import hashlib
import json
from dataclasses import dataclass
from importlib.resources import files
from typing import Any
from urllib.parse import quote

import jinja2
import pandas as pd
from markupsafe import Markup

from miho.analysis.text import cell, is_numeric

PAGE = "report.html"


@dataclass(frozen=True)
class Table:
    """The cells of a table as text; `numeric` marks the columns that are aligned to the right.

    The first column contains the headings of the rows.
    """

    heads: list[str]
    numeric: list[bool]
    rows: list[list[str]]

    @classmethod
    def of(cls, frame: pd.DataFrame) -> Table:
        """The cells of a frame, with numbers formatted as in all tables."""
        numeric = [is_numeric(frame[name]) for name in frame.columns]
        rows = [[cell(value) for value in row] for row in frame.itertuples(index=False, name=None)]
        return cls([str(name) for name in frame.columns], [False, *numeric[1:]], rows)


def render(name: str, **values: Any) -> str:
    """The page that a template makes of these values."""
    return environment().get_template(name).render(**values)


def asset(name: str) -> Markup:
    """A script or style sheet of this package, to be embedded in a page."""
    path = files("miho.analysis.pages").joinpath("templates", name)
    return Markup(path.read_text(encoding="utf-8"))  # noqa: S704 - a file of this package


def digest(text: str) -> str:
    """The name of a script or style in a Content-Security-Policy."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}"


def _json(value: Any) -> Markup:
    """JSON for a script element; text in it cannot close the element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return Markup(text)  # noqa: S704 - nothing in it closes the element


def _data_uri(picture: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(picture).decode('ascii')}"


def environment() -> jinja2.Environment:
    """The environment of the templates, which escapes all values."""
    templates = jinja2.Environment(
        loader=jinja2.PackageLoader("miho.analysis.pages"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.filters |= {
        "table": Table.of, "script_json": _json, "data_uri": _data_uri, "path": quote,
        "digest": digest,
    }  # fmt: skip
    return templates
