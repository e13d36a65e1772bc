"""The notebooks hold what they show, and run from top to bottom in a fresh clone."""

import re
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import nbformat
import pandas as pd
import pytest

from experiments import notebooks
from experiments.notebooks import FOLDER, machine_names, shown_text
from miho.analysis.styles import STYLES
from miho.analysis.variants import base_name

ROOT = FOLDER.parent
PATHS = sorted(FOLDER.glob("*.ipynb"))


def pictures(notebook: nbformat.NotebookNode) -> int:
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    return sum("image/png" in output.get("data", {}) for output in outputs)


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_a_reader_sees_what_it_shows(path: Path) -> None:
    """`make notebooks` has run all cells in their order, and stored nothing of the machine."""
    notebook = nbformat.read(path, as_version=4)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert pictures(notebook), "the figure is shown"
    outputs = [output for cell in cells for output in cell.outputs]
    assert not [output for output in outputs if output.output_type == "error"]
    assert not [output for output in outputs if output.get("name") == "stderr"]
    assert not [cell for cell in cells if "execution" in cell.metadata], "no times"
    assert machine_names(notebook) == []
    assert path.stat().st_size < 600_000


class Tables(HTMLParser):
    """The cells of each row of all tables, as texts."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.inside = False
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: object) -> None:
        if tag == "tr":
            self.rows.append([])
        self.inside = tag in ("th", "td")
        if self.inside:
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        self.inside = False

    def handle_data(self, data: str) -> None:
        if self.inside:
            self.rows[-1][-1] += data


def methods_shown(notebook: nbformat.NotebookNode) -> set[str]:
    """The methods that commands name, and those in columns of tables, without their settings."""
    names: set[str] = set()
    for cell in notebook.cells:
        for words in re.findall(r"\boptimizer=([\w,]+)", cell.source):
            names |= set(words.split(","))
        for output in cell.get("outputs", []):
            place = length = -1
            for row in Tables(output.get("data", {}).get("text/html", "")).rows:
                titles = [row.index(title) for title in ("optimizer", "method") if title in row]
                if titles:
                    place, length = titles[0], len(row)
                elif len(row) == length and row[place].strip():
                    names.add(row[place])
    return {name for name in names if name[:1].isalpha()}


def known_methods() -> set[str]:
    configured = {path.stem for path in (ROOT / "conf/optimizer").glob("*.yaml")}
    return configured | {STYLES[name].name for name in configured if name in STYLES}


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_the_methods_shown_are_those_of_today(path: Path) -> None:
    """What was renamed or removed since a notebook was run may not stay in what it shows."""
    shown = methods_shown(nbformat.read(path, as_version=4))
    known = known_methods()
    assert {name for name in shown if name not in known and base_name(name) not in known} == set()


def test_a_method_of_the_past_is_noticed() -> None:
    table = pd.DataFrame({"method": ["miho R=300", "old_name"], "error": [1, 2]}).to_html()
    output = nbformat.v4.new_output("display_data", data={"text/html": table})
    cell = nbformat.v4.new_code_cell("run('optimizer=pso_100,gone')", outputs=[output])
    shown = methods_shown(nbformat.v4.new_notebook(cells=[cell]))
    assert shown == {"miho R=300", "old_name", "pso_100", "gone"}
    assert {base_name(name) for name in shown} - known_methods() == {"old_name", "gone"}


def test_the_comparison_is_judged_as_on_the_results_page() -> None:
    """The sentence on MIHO's error at the paper's size says in the notebook what the page says."""
    text = shown_text(nbformat.read(FOLDER / "ablation.ipynb", as_version=4))
    page = (ROOT / "docs/results/paper_fig6/results.csv").read_text(encoding="utf-8")
    measured = float(
        next(line for line in page.splitlines() if line.startswith("miho,")).split(",")[2]
    )
    low, high = map(float, re.findall(r"end at ([\d.]+) to ([\d.]+) kN", text)[0])
    assert (low, high) == pytest.approx((measured, measured), abs=0.005), "half a printed digit"


def test_a_tire_is_fitted_first_and_to_its_optimum() -> None:
    """B of the best known optimum (`conf/problem/tire_lf.yaml`), before any other method's."""
    notebook = nbformat.read(FOLDER / "identify_a_tire.ipynb", as_version=4)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    places = {
        call: next(k for k, cell in enumerate(cells) if call in cell.source)
        for call in ("miho.fit(", "miho.minimize(")
    }
    assert places["miho.fit("] < places["miho.minimize("]
    rows = Tables(cells[places["miho.fit("]].outputs[0].data["text/html"]).rows
    assert next(row for row in rows if row[0] == "B")[1] == "12.56"


def test_names_of_a_machine_are_noticed() -> None:
    text = "in /home/me/miho/runs, see https://example.org/home/x and runs/tmp/y, /tmp/tmp1a/b'"
    output = nbformat.v4.new_output("stream", text=text)
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("1", outputs=[output])])
    assert machine_names(notebook) == ["/home/me/miho/runs,", "/tmp/tmp1a/b"]


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that git tracks, as they are here, and the machine that `make install` builds."""
    folder = tmp_path_factory.mktemp("clone")
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    built = [path.relative_to(ROOT).as_posix() for path in ROOT.glob("miho/core/_machine*.so")]
    for name in [*filter(None, listed.stdout.split("\0")), *built]:
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes((ROOT / name).read_bytes())
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", [path.stem for path in PATHS])
def test_it_runs_in_a_fresh_clone(name: str, clone: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the outputs of before, which it makes again."""
    monkeypatch.setattr(notebooks, "CHECKOUT", clone)
    for variable in ("MIHO_RUNS", "MIHO_ARENA", "MIHO_ABLATION"):
        monkeypatch.delenv(variable, raising=False)
    before = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    notebook = notebooks.run_notebook(clone / "notebooks" / f"{name}.ipynb")
    assert pictures(notebook) == pictures(before)
    assert shown_text(notebook)
    assert "Error" not in shown_text(notebook)
