"""The notebooks hold what they show, and run from top to bottom in a fresh clone."""

import subprocess
from pathlib import Path

import nbformat
import pytest

from experiments import notebooks
from experiments.notebooks import FOLDER, machine_names, shown_text

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


def test_names_of_a_machine_are_noticed() -> None:
    text = "in /home/me/miho/runs, see https://example.org/home/x and runs/tmp/y, /tmp/tmp1a/b'"
    output = nbformat.v4.new_output("stream", text=text)
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("1", outputs=[output])])
    assert machine_names(notebook) == ["/home/me/miho/runs,", "/tmp/tmp1a/b"]


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that git tracks, as they are here, and nothing that earlier runs left."""
    folder = tmp_path_factory.mktemp("clone")
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    for name in filter(None, listed.stdout.split("\0")):
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
