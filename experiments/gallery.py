"""Run the code on the pages of the manual's gallery, and write their pictures and results.

python -m experiments.gallery              # all of them, some 20 CPU seconds
python -m experiments.gallery tire prior   # only these
"""

import contextlib
import io
import runpy
import sys
import tempfile
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
from PIL import Image

from experiments.app.console import chosen_names
from experiments.app.gallery_pages import (
    FOLDER,
    NAMES,
    build_fmu,
    index_page,
    missing_for_fmu,
    read_example,
)

STYLE = FOLDER / "gallery.mplstyle"
COLORS = 128
"""Number of colors of a stored picture, which keeps files small."""


def run_example(name: str, folder: Path) -> str:
    """Run an example, which saves NAME.png in the folder, and return the text that it prints."""
    if name == "fmu":
        build_fmu(folder / "swing.fmu")
    printed = io.StringIO()
    with (
        mpl.rc_context({"backend": "Agg"}, STYLE),
        contextlib.chdir(folder),
        contextlib.redirect_stdout(printed),
    ):
        script = Path(f"{name}.py")
        script.write_text(read_example(name).code, encoding="utf-8")
        runpy.run_path(str(script), run_name="__main__")
    plt.close("all")
    return "\n".join(line.rstrip() for line in printed.getvalue().strip("\n").splitlines())


def write_example(name: str) -> None:
    """Run an example and store its picture and its result."""
    with tempfile.TemporaryDirectory() as folder:
        printed = run_example(name, Path(folder))
        with Image.open(Path(folder, f"{name}.png")) as picture:
            small = picture.convert("RGB").quantize(COLORS, dither=Image.Dither.NONE)
            small.save(FOLDER / f"{name}.png", optimize=True)
    page = read_example(name)._replace(printed=printed).page
    (FOLDER / f"{name}.md").write_text(page, encoding="utf-8")


def main() -> None:
    """Run the named examples, or all, and write their results and the index."""
    for name in chosen_names(__doc__, NAMES):
        if name == "fmu" and (reason := missing_for_fmu()):
            print(f"fmu: left out: {reason}", file=sys.stderr)
            continue
        print(name, flush=True)
        write_example(name)
    (FOLDER / "index.md").write_text(index_page(), encoding="utf-8")


if __name__ == "__main__":
    main()
