"""Pieces of HTML for the page of a sweep; whatever is put in is escaped."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any
from urllib.parse import quote

import pandas as pd

from miho.analysis.markdown import number

NUMBER = re.compile(r"[-+−]?[\d.,]*\d(e[-+]?\d+)?|[-∞]|-?inf|never|\[.*\]")


@dataclass(frozen=True)
class Choice:
    """Buttons of which one is pressed: what they set, and the values with their labels."""

    label: str
    name: str
    options: Sequence[tuple[str, str]]
    chosen: str


def table(frame: pd.DataFrame, caption: str = "") -> str:
    """A table whose first column heads its rows; it scrolls by itself where it is too wide."""
    kinds = ["" if _is_numeric(frame[name]) else ' class="text"' for name in frame.columns]
    kinds[0] = ' class="text"'
    heads = [f'<th scope="col"{k}>{escape(str(n))}</th>' for n, k in zip(frame, kinds, strict=True)]
    rows = []
    for first, *rest in frame.itertuples(index=False, name=None):
        cells = [f'<th scope="row" class="text">{escape(_cell(first))}</th>']
        cells += [
            f"<td{kind}>{escape(_cell(value))}</td>"
            for value, kind in zip(rest, kinds[1:], strict=True)
        ]
        rows.append(f"<tr>{''.join(cells)}</tr>")
    told = f"<caption>{escape(caption)}</caption>" if caption else ""
    label = escape(caption or str(frame.columns[0]), quote=True)
    return (
        f'<div class="scroll" role="region" tabindex="0" aria-label="{label}"><table>{told}'
        f"<thead><tr>{''.join(heads)}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def items(sentences: Sequence[str]) -> str:
    """A list of sentences, nothing without any."""
    return f"<ul>{''.join(f'<li>{escape(one)}</li>' for one in sentences)}</ul>" * bool(sentences)


def facts(pairs: Sequence[tuple[str, str]]) -> str:
    """Names and values, side by side."""
    told = (f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in pairs)
    return f'<dl class="facts">{"".join(told)}</dl>'


def buttons(choice: Choice) -> str:
    """The buttons of a choice; the script reads `data-set` and `data-to`."""
    told = "".join(
        f'<button type="button" data-set="{escape(choice.name)}" data-to="{escape(value)}" '
        f'aria-pressed="{"true" if value == choice.chosen else "false"}">{escape(label)}</button>'
        for value, label in choice.options
    )
    return (
        f'<div class="choice" role="group" aria-label="{escape(choice.label)}">'
        f"<span>{escape(choice.label)}</span>{told}</div>"
    )


def link(path: str, text: str) -> str:
    """A link to a file below the page's folder, or above it."""
    return f'<a href="{escape(quote(path), quote=True)}">{escape(text)}</a>'


def data(identity: str, value: Any) -> str:
    """JSON for the script, which no text inside can close."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return f'<script type="application/json" id="{escape(identity)}">{text}</script>'


def policy(style: str, script: str) -> str:
    """The meta tag that lets a page run this style and this script, and load nothing."""
    allowed = f"default-src 'none'; img-src data:; style-src {_hash(style)}; "
    allowed += f"script-src {_hash(script)}; base-uri 'none'; form-action 'none'"
    return f'<meta http-equiv="Content-Security-Policy" content="{allowed}">'


def _hash(text: str) -> str:
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
    return f"'sha256-{digest}'"


def _cell(value: object) -> str:
    if isinstance(value, bool | str):
        return str(value)
    return number(float(value)) if isinstance(value, int | float) else str(value)


def _is_numeric(column: pd.Series) -> bool:
    """Whether a column holds numbers, which are read from the right."""
    return all(NUMBER.fullmatch(_cell(value)) for value in column)
