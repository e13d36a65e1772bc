"""The pages of the manual's gallery, one for each example, an index, and the FMU of an example."""

import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from importlib.util import find_spec
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


SOURCES = FOLDER / "swing"
DESCRIPTION = "modelDescription.xml"
INTERFACES = ("CoSimulation", "ModelExchange")


def missing_for_fmu() -> str:
    """The reason why this machine cannot build or run the FMU; empty if it can."""
    if find_spec("fmpy") is None:
        return "FMPy is not installed; pip install 'miho[fmu]'"
    if not sys.platform.startswith("linux") or shutil.which("cc") is None:
        return "the FMU is built by a C compiler on Linux"
    return ""


def description(*interfaces: str) -> str:
    """The text of modelDescription.xml with only these interfaces."""
    text = (SOURCES / DESCRIPTION).read_text(encoding="utf-8")
    for name in set(INTERFACES).difference(interfaces):
        text = re.sub(rf"\s*<{name} [^>]*/>", "", text)
    return text


def build_fmu(path: Path, *interfaces: str) -> None:
    """Compile and pack the FMU with these interfaces, by default with both."""
    import fmpy  # of an extra

    headers = Path(fmpy.__file__).parent / "c-code"
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(path, "w") as archive:
        library = Path(folder, "swing.so")
        command = ["cc", "-shared", "-fPIC", "-O2", f"-I{headers}", str(SOURCES / "swing.c"), "-o"]
        subprocess.run([*command, str(library)], check=True)
        archive.writestr(DESCRIPTION, description(*(interfaces or INTERFACES)))
        archive.write(library, "binaries/linux64/swing.so")
