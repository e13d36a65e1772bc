"""Nothing of ours reads pickles, runs text or listens to a network."""

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal", "torch", "joblib"}
CALLS = {"eval", "exec", "compile", "__import__", "read_pickle", "to_pickle", "unsafe_load"}
ALLOWED = {
    # the model in a file of the user's, the one door for code
    ("miho/models/user_file.py", "exec"),
    ("miho/models/user_file.py", "compile"),
    # formulas that are written from a graph of known operations and numbers
    ("miho/models/formula_text.py", "exec"),
    ("miho/models/formula_text.py", "compile"),
    # the conformance suite copies what it has just made
    ("miho/testing/optimizers.py", "pickle"),
    # what a process and the workers that it has started, or was told to use, send to each other
    ("miho/parallel/pool.py", "cloudpickle"),
    ("miho/parallel/process_executor.py", "pickle"),
    ("miho/parallel/remote.py", "pickle"),
}


def sources() -> list[Path]:
    folders = ("miho", "baselines", "experiments")
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def suspicious(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield (node.module or "").partition(".")[0]
        elif isinstance(node, ast.Call):
            called = node.func
            owner = getattr(getattr(called, "value", None), "id", "")
            name = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")
            if owner not in ("re", "nn") and name in CALLS:
                yield name
            if owner == "yaml" and name == "load":
                yield "yaml.load"
        elif isinstance(node, ast.keyword) and node.arg == "allow_pickle":
            yield "allow_pickle"


def test_no_pickle_is_read_and_no_text_is_run() -> None:
    banned = MODULES | CALLS | {"yaml.load", "allow_pickle"}
    found = {
        (path.relative_to(ROOT).as_posix(), name)
        for path in sources()
        for name in suspicious(ast.parse(path.read_bytes()))
        if name in banned
    }
    assert found == ALLOWED


def test_the_search_finds_what_it_is_for() -> None:
    text = "import pickle\nnp.load(f, allow_pickle=True)\neval('1')\nyaml.load(f)\nre.compile('x')"
    found = set(suspicious(ast.parse(text)))
    assert found == {"pickle", "allow_pickle", "eval", "yaml.load"}


@pytest.mark.slow
def test_a_sweep_listens_to_no_network(tmp_path: Path) -> None:
    """Every process of it reports what it binds to; sockets of this machine's files may be."""
    (tmp_path / "sitecustomize.py").write_text(
        "import sys\n"
        "def hook(event, arguments):\n"
        "    if event == 'socket.bind' and isinstance(arguments[1], tuple):\n"
        f"        open({str(tmp_path / 'bound')!r}, 'a').write(repr(arguments[1]))\n"
        f"open({str(tmp_path / 'watched')!r}, 'a').write('x')\n"
        "sys.addaudithook(hook)\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    control = "import socket; socket.socket().bind(('127.0.0.1', 0))"
    subprocess.run([sys.executable, "-c", control], check=True, env=environment)
    assert (tmp_path / "bound").exists()
    (tmp_path / "bound").unlink()
    sweep = [
        "-m", "seed=1,2", "optimizer=random", "dataset.n=40", "budget.evaluations=40",
        f"root={tmp_path / 'runs'}",
    ]  # fmt: skip
    command = [sys.executable, "-m", "experiments.identify", *sweep]
    subprocess.run(command, check=True, env=environment, cwd=ROOT, capture_output=True)
    assert len((tmp_path / "watched").read_text()) >= 2
    assert not (tmp_path / "bound").exists()
