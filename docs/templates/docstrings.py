"""Docstrings in Markdown: citations, references, names of public objects, groups of parameters."""

import re
from typing import Any

import griffe

REWRITES = (
    (r"\[(\d+)\]_", r"[\1]"),
    (r"^\.\. \[(\d+)\]", r"\1."),
    (r"^(\w+) : (?=[A-Z].*\.$)", r"* `miho.\1`: "),  # an entry of See Also
    (r"`(miho\.[\w.]+)`", r'<autoref identifier="\1" optional><code>\1</code></autoref>'),
)
PARAMETERS = re.compile(
    r"(?<=^(?:Parameters|Attributes)\n----------\n).*?(?=\n\n\S|\Z)", re.DOTALL | re.MULTILINE
)
HEAD = re.compile(r"^([*\w][*\w, ]*?)(?: : (.+))?$", re.MULTILINE)


class Markdown(griffe.Extension):
    """Citations become numbers, references numbered lists, and documented names links.

    Parameters that share a description stay together, because each of them would get the type and
    the default of the first. A set of choices and a list of types stay text, because the first
    choice would become the default. A thin space, which Python's grammar lacks, does both.
    """

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of an object that was loaded."""
        if obj.docstring:
            text = PARAMETERS.sub(lambda found: HEAD.sub(head, found[0]), obj.docstring.value)
            for pattern, replacement in REWRITES:
                text = re.sub(pattern, replacement, text, flags=re.MULTILINE)
            obj.docstring.value = text


def head(found: re.Match[str]) -> str:
    """The first line of an entry of a section Parameters or Attributes."""
    names = found[1].replace(", ", ",\u2009")
    if found[2] in (None, "optional"):  # the signature has the types
        return names
    types = found[2].removesuffix(", optional")
    if types.startswith("{"):
        types = types.strip("{}").replace("'", '"')
    return f"{names} : {types.replace(' ', chr(0x2009)) if ', ' in types else types}"
