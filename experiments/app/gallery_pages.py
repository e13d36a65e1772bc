"""The pages of the manual's gallery: one for each example, with its code, and an index."""

from __future__ import annotations

import re
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
PAGE = re.compile(
    r"# (?P<title>.+?)\n\n!\[(?P<question>.+?)\].*?\*\*(?P=question)\*\* (?P<text>.+?)\n\n"
    r"```python\n(?P<code>.+?)\n```\n\n.+?\n\n```text\n(?P<printed>.*?)\n```\n",
    re.DOTALL,
)
"""The page of an example."""
NAMES = [name for names in SECTIONS.values() for name in names]


class Example(NamedTuple):
    """An example: its title, the question, the text about it, its code, and the printed result."""

    name: str
    title: str
    question: str
    text: str
    code: str
    printed: str

    @property
    def page(self) -> str:
        """Its page, docs/gallery/NAME.md."""
        return f"""# {self.title}

![{self.question}]({self.name}.png)

**{self.question}** {self.text}

```python
{self.code}
```

It prints:

```text
{self.printed}
```
"""


def read_example(name: str) -> Example:
    """Read an example from its page."""
    page = (FOLDER / f"{name}.md").read_text(encoding="utf-8")
    parts = PAGE.fullmatch(page)
    if parts is None:
        raise ValueError(f"{name}.md: expected title, picture, question, code and printed result")
    return Example(name, **parts.groupdict())


def index_page() -> str:
    """The first page of the gallery: the pictures with their questions."""
    lines = [
        "# Gallery",
        "",
        "Each picture links to its example, a script of at most 50 lines to copy and run. All data",
        "are simulated, with a seed. `python -m experiments.gallery` runs the examples and writes",
        "their pictures and results.",
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
