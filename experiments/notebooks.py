"""Run the notebooks and store them with their outputs, for readers of the repository.

python -m experiments.notebooks            # all notebooks, about two minutes
python -m experiments.notebooks read_a_sweep
"""

import os
import re
import socket
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

from experiments.app.console import chosen_names

CHECKOUT = Path(__file__).resolve().parents[1]
FOLDER = CHECKOUT / "notebooks"
LIMIT = 300
"""Time limit of one cell [s]."""
TOPS = "home|root|tmp|usr|opt|var|work|mnt|srv|Users|private"
"""Where absolute paths begin."""


def run_notebook(path: Path) -> nbformat.NotebookNode:
    """Run a notebook in a new kernel without the user's settings; return it with its outputs.

    Raises ValueError if an output shows a path or the name of this machine.
    """
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as home:
        environment = os.environ | {"IPYTHONDIR": home, "PYTHONPATH": str(CHECKOUT)}
        client = NotebookClient(
            notebook, timeout=LIMIT, resources={"metadata": {"path": str(path.parent)}},
            extra_arguments=["--log-level=40"],  # errors only
        )  # fmt: skip
        client.execute(env=environment)
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)  # when each cell began and ended
    notebook.metadata["language_info"] = {"name": "python"}
    leaks = machine_names(notebook)
    if leaks:
        raise ValueError(f"{path.name} shows {', '.join(leaks)}; print nothing of this machine")
    return notebook


def shown_text(notebook: nbformat.NotebookNode) -> str:
    """Text of all outputs, without images."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    texts = [str(output.get("text", "")) for output in outputs]
    for output in outputs:
        texts += [str(v) for k, v in output.get("data", {}).items() if not k.startswith("image/")]
    return "\n".join(texts)


def machine_names(notebook: nbformat.NotebookNode) -> list[str]:
    """Absolute paths in the outputs, and the name of this machine if it occurs."""
    text = shown_text(notebook)
    paths = re.findall(rf"(?<![\w.<])/(?:{TOPS})/[^\s\"'<]*", text)
    host = socket.gethostname()
    return sorted({*paths, *([host] if re.search(rf"\b{re.escape(host)}\b", text) else [])})


def main() -> None:
    """Parse the arguments, run the named notebooks, or all, and store each with its outputs."""
    for name in chosen_names(__doc__, sorted(path.stem for path in FOLDER.glob("*.ipynb"))):
        path = FOLDER / f"{name}.ipynb"
        print(path.relative_to(CHECKOUT), flush=True)
        nbformat.write(run_notebook(path), path)


if __name__ == "__main__":
    main()
