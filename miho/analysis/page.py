"""One self-contained HTML page: text, tables and figures; no script, nothing loaded."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import pandas as pd
from matplotlib.figure import Figure

from miho.analysis.figures import house_style

STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff;
       max-width: 60rem; margin: 0 auto; padding: 1rem 1.25rem 4rem; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 1rem 0 .25rem; }
h2 { font-size: 1.15rem; margin: 2.25rem 0 .5rem; border-bottom: 1px solid #ccc; }
p, li { max-width: 46rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .92rem; }
p.note { color: #555; margin: .25rem 0 .75rem; }
th, td { padding: .25rem .7rem; text-align: right; border-bottom: 1px solid #e4e4e4;
         white-space: nowrap; }
th { border-bottom: 1.5px solid #888; font-weight: 600; }
th.text, td.text { text-align: left; }
td.text:last-child { white-space: normal; }
img { max-width: 100%; height: auto; }
/* Where there is no room for a line a cell, or nothing to scroll with, cells wrap, and the columns
   share the width of the page: 4.2 em each hold a correlation, 5.6 em half an interval. */
@media (max-width: 40rem) {
  body { padding: .5rem .75rem 3rem; }
  th, td { white-space: normal; padding: .25rem .2rem; }
  table { font-size: clamp(.64rem, calc((100vw - 1.5rem) / var(--columns) / 5.6), .8rem); }
  th:first-child, td:first-child { position: sticky; left: 0; background: #fff; padding-left: 0; }
  td.text:nth-child(2):last-child { overflow-wrap: anywhere; }
}
@media print {
  @page { margin: 15mm; }
  body { max-width: none; margin: 0; padding: 0; font-size: 10.5pt; }
  h2, thead { break-after: avoid; }
  img, tr { break-inside: avoid; }
  .scroll { overflow: visible; }
  table { font-size: min(8.5pt, calc(170mm / var(--columns) / 4.2)); }
  th, td { white-space: normal; padding: .25em .5em; }
  th, td.text:nth-child(2):last-child { overflow-wrap: anywhere; }
}
"""


@dataclass(frozen=True)
class Section:
    """A heading with what stands below it, in this order; empty parts are left out.

    `figure` is a picture as `png` makes it.
    """

    heading: str
    sentences: Sequence[str] = ()
    table: pd.DataFrame | None = None
    figure: bytes | None = None
    caption: str = ""


def page(title: str, subtitle: str, sections: Sequence[Section]) -> str:
    """The page's HTML. All text is escaped; table cells are written as they are in the frame."""
    body = "\n".join(map(_section, sections))
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        f"<h1>{escape(title)}</h1>\n<p>{escape(subtitle)}</p>\n{body}\n</body>\n</html>\n"
    )


def png(figure: Figure) -> bytes:
    """The figure as a picture for a page."""
    buffer = io.BytesIO()
    with house_style():
        figure.savefig(buffer, format="png", dpi=120)
    return buffer.getvalue()


def _section(section: Section) -> str:
    parts = [f"<h2>{escape(section.heading)}</h2>"]
    if len(section.sentences) == 1:
        parts.append(f"<p>{escape(section.sentences[0])}</p>")
    elif section.sentences:
        items = "".join(f"<li>{escape(sentence)}</li>" for sentence in section.sentences)
        parts.append(f"<ul>{items}</ul>")
    if section.table is not None and len(section.table):
        parts.append(_table(section.table))
    if section.figure is not None:
        alt = escape(section.caption or section.heading, quote=True)
        data = base64.b64encode(section.figure).decode("ascii")
        parts.append(f'<img alt="{alt}" src="data:image/png;base64,{data}">')
    if section.caption:
        parts.append(f'<p class="note">{escape(section.caption)}</p>')
    return "\n".join(parts)


def _table(frame: pd.DataFrame) -> str:
    kinds = [' class="text"' if _is_text(frame[name]) else "" for name in frame.columns]
    head = "".join(
        f'<th scope="col"{kind}>{escape(str(name))}</th>'
        for name, kind in zip(frame.columns, kinds, strict=True)
    )
    rows = []
    for row in frame.itertuples(index=False):
        cells = (
            f"<td{kind}>{escape(str(value))}</td>" for value, kind in zip(row, kinds, strict=True)
        )
        rows.append(f"<tr>{''.join(cells)}</tr>")
    return (
        f'<div class="scroll"><table style="--columns: {len(frame.columns)}">'
        f"<thead><tr>{head}</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _is_text(column: pd.Series) -> bool:
    """Whether a column holds words or units, which are read from the left, and not numbers."""
    return any(re.search("[a-df-zA-Z]", str(value).replace("inf", "")) for value in column)
