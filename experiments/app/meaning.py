"""The meaning of a program, as text that is the same for every Python version that can read it.

This file imports only the standard library, so that any version of Python can run it.
"""

import ast
from typing import Any

IGNORED = ("kind", "type_comment", "type_ignores")
"""Fields of a syntax tree for spelling and comments."""


def meaning_of(node: Any) -> str:
    """Meaning of a syntax tree, or of a value in one, as text without docstrings.

    All Python versions that can read the program give the same text. Empty fields are omitted,
    because versions differ in the fields that exist. Other characters than ASCII are escaped,
    because versions differ in which they can print. `ast.dump` does neither.
    """
    if isinstance(node, ast.AST):
        fields = {name: value for name, value in ast.iter_fields(node) if name not in IGNORED}
        if isinstance(fields.get("body"), list):
            fields["body"] = [line for line in fields["body"] if not _is_text(line)]
        if isinstance(node, ast.JoinedStr):  # 3.12 has empty texts between its parts
            fields["values"] = [part for part in node.values if getattr(part, "value", None) != ""]
        values = {name: value for name, value in fields.items() if value not in (None, [])}
        texts = (f"{name}={meaning_of(value)}" for name, value in values.items())
        return f"{type(node).__name__}({','.join(texts)})"
    if isinstance(node, list):
        return f"[{','.join(map(meaning_of, node))}]"
    return ascii(node)


def _is_text(line: ast.AST) -> bool:
    """Return whether a statement is only a string, which does nothing."""
    alone = isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant)
    return alone and isinstance(line.value.value, str)  # type: ignore[attr-defined]
