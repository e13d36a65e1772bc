"""The notebooks run from top to bottom, on a small comparison made for them."""

import os
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from experiments.build import build
from experiments.cli import composed
from experiments.run import run
from experiments.schema import register

NOTEBOOKS = Path(__file__).parent.parent / "notebooks"
METHODS = ("miho", "gbo_small", "gbo_large", "pso_100", "pso_500", "random", "least_squares")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A comparison of 3 repetitions, some 2000 evaluations each."""
    register()
    root = tmp_path_factory.mktemp("runs")
    small = ["dataset.n=100", "budget.evaluations=2000", f"root={root}"]
    for seed in range(3):
        for method in METHODS:
            run(build(composed([f"optimizer={method}", f"seed={seed}", *small])))
    return root


@pytest.fixture(scope="module")
def arena(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three methods on two problems of known optimum."""
    root = tmp_path_factory.mktemp("arena")
    for problem in ("torque_15", "brake_static"):
        for method in ("miho", "pso_100", "least_squares"):
            asked = [f"problem={problem}", f"optimizer={method}", "budget.evaluations=3000"]
            for seed in range(3):
                run(build(composed([*asked, f"seed={seed}", f"root={root}"])), quiet=True)
    return root


@pytest.fixture(scope="module")
def ablation(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """MIHO with two sizes and two reaches."""
    root = tmp_path_factory.mktemp("ablation")
    for setting in ("optimizer.R=9", "optimizer.R=27", "space.B.sigma_max=20"):
        asked = ["dataset.n=100", "optimizer=miho", "optimizer.R=9", setting, f"root={root}"]
        for seed in range(3):
            run(build(composed([*asked, f"seed={seed}"])), quiet=True)
    return root


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(NOTEBOOKS.glob("*.ipynb")), ids=lambda path: path.stem)
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_notebook(
    path: Path, runs: Path, arena: Path, ablation: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MIHO_RUNS", str(runs))
    monkeypatch.setenv("MIHO_ARENA", str(arena))
    monkeypatch.setenv("MIHO_ABLATION", str(ablation))
    monkeypatch.setenv("PYTHONPATH", str(NOTEBOOKS.parent))
    monkeypatch.setenv("IPYTHONDIR", str(runs / ".ipython"))
    notebook = nbformat.read(path, as_version=4)
    assert all(not cell.get("outputs") for cell in notebook.cells), "commit without outputs"
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(NOTEBOOKS)}}).execute(
        env=dict(os.environ)
    )
    pictures = [
        output
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    ]
    assert pictures, "the figure is shown"
