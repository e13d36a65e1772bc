"""Docstrings in Markdown: their citations, lists of references and names of public objects."""

import re
from typing import Any

import griffe

REWRITES = (
    (r"\[(\d+)\]_", r"[\1]"),
    (r"^\.\. \[(\d+)\]", r"\1."),
    (r"`(miho\.[\w.]+)`", r'<autoref identifier="\1" optional><code>\1</code></autoref>'),
)


class Markdown(griffe.Extension):
    """Citations become numbers, references numbered lists, and documented names links."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of an object that was loaded."""
        if obj.docstring:
            for pattern, text in REWRITES:
                obj.docstring.value = re.sub(pattern, text, obj.docstring.value, flags=re.MULTILINE)
