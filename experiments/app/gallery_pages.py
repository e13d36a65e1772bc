"""The pages of the manual's gallery: one for each example, and an index of the pictures."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import NamedTuple

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "gallery"
COLUMNS = 3
"""Number of pictures side by side in the index."""
SECTIONS = {
    "Vehicles and machines": (
        "tire", "engine_torque", "driving_log", "online", "battery_pulse", "robot_joint",
        "damped_modes",
    ),
    "Chemistry and biology": (
        "spectrum", "enzyme", "dose_response", "logistic_growth", "pharmacokinetics",
    ),
    "Models that are not formulas": ("simulation", "fmu", "external_program"),
    "Knowledge and data": ("joint_fit", "fixed_and_tied", "prior", "robust_loss", "next_test"),
    "Many fits, many methods": ("many_fits", "compare_methods"),
}  # fmt: skip
"""The names of the examples in their order on the index page."""
TITLES = {"fmu": "FMU"}
"""The titles of pages that are not their names."""
NAMES = [name for names in SECTIONS.values() for name in names]


class Example(NamedTuple):
    """An example: its name, the question, further paragraphs of its docstring, and its code."""

    name: str
    question: str
    text: str
    code: str

    @property
    def title(self) -> str:
        """The title of its page."""
        return TITLES.get(self.name, self.name.replace("_", " ").capitalize())


def read_example(name: str) -> Example:
    """Read docs/gallery/NAME.py and separate its docstring from its code."""
    source = (FOLDER / f"{name}.py").read_text(encoding="utf-8")
    tree = ast.parse(source)
    question, _, text = (ast.get_docstring(tree) or "").partition("\n\n")
    code = "\n".join(source.splitlines()[tree.body[0].end_lineno :])
    return Example(name, question, text, code.strip())


def example_page(example: Example, printed: str) -> str:
    """The page of an example: picture, question, code and printed result."""
    return f"""# {example.title}

![{example.question}]({example.name}.png)

**{example.question}** {example.text}

```python
{example.code}
```

It prints:

```text
{printed}
```
"""


def index_page() -> str:
    """The first page of the gallery: the pictures with their questions."""
    lines = [
        "# Gallery",
        "",
        "Each picture links to its example, a script of at most 50 lines to copy and run. All data",
        "are simulated, with a seed. `python -m experiments.gallery` runs the examples and writes",
        "these pages.",
    ]
    for section, names in SECTIONS.items():
        lines += ["", f"## {section}", "", "| " * COLUMNS + "|", "| --- " * COLUMNS + "|"]
        cells = [_cell(read_example(name)) for name in names]
        cells += [""] * (-len(cells) % COLUMNS)
        rows = [cells[k : k + COLUMNS] for k in range(0, len(cells), COLUMNS)]
        lines += [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([*lines, ""])


def _cell(example: Example) -> str:
    picture = f'<img src="{example.name}.png" alt="{example.title}" width="230">'
    return f"[{picture}]({example.name}.md)<br>**{example.title}**: {example.question}"
