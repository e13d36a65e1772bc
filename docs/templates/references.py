"""References of docstrings in Markdown: `[1]_` and `.. [1] text` are reStructuredText."""

import re
from typing import Any

import griffe


class References(griffe.Extension):
    """Turn citations into plain numbers and lists of references into numbered lists."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of an object that was loaded."""
        if obj.docstring:
            text = re.sub(r"\[(\d+)\]_", r"[\1]", obj.docstring.value)
            obj.docstring.value = re.sub(r"^\.\. \[(\d+)\]", r"\1.", text, flags=re.MULTILINE)
