"""R16: secrets in the environment, in settings and in URLs, and where they turn up again."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

import pytest

from tests.faults.commands import CHECKOUT, Call, called
from tests.faults.conftest import Figures

VARIABLE = "MIHO_CANARY_TOKEN"
CANARIES = ("canary-of-the-environment", "canary-of-a-setting", "canary-of-a-url")
QUICK = ["dataset.n=40", "optimizer=random", "optimizer.batch=10", "budget.evaluations=40"]
MODEL = f"""import os
calls = 0


def line(alpha: "rad", *, a: "N/rad") -> "N":
    global calls
    calls += 1
    if calls > os.environ.get("AFTER_CALLS", "").count("x"):
        raise RuntimeError("cannot log in with " + os.environ["{VARIABLE}"])
    return a * alpha
"""
"""A model of the user's that fails, at once or during a run, and says too much."""


@pytest.mark.slow
@pytest.mark.fault(
    row="R16",
    fault="secrets in the environment, settings and URLs of commands and a notebook",
    promise="0 occurrences in results, tracker, reports, notebook, output and error text",
)
def test_secrets(tmp_path: Path, measured: Figures) -> None:
    """Commands that know secrets; then every file below their root and all they print."""
    model, root = tmp_path / "mine.py", tmp_path / "runs"
    model.write_text(MODEL, encoding="utf-8")
    environment, setting, url = CANARIES
    address = f"https://user:{url}@localhost/lf.tir"
    own = [
        f"model.path={model}", "model=function", "~space",
        "+space={a: {unit: N/rad, low: -1e6, high: 0}}",
    ]  # fmt: skip
    expected = {
        (): 0,
        (f"dataset.tire=${{oc.env:{VARIABLE}}}",): 2,
        ("--cfg", "job", "--resolve", f"dataset.tire=${{oc.env:{VARIABLE}}}"): 2,
        (f"dataset.tire={environment}",): 2,
        (f"seed={environment}",): 2,
        (f"+password={setting}",): 2,
        (f"+dataset.password={setting}",): 2,
        ("-m", "seed=1,2", f"+optimizer.token={setting}"): 2,
        (f"dataset.tire={address}",): 2,
        (f"problem.name={address}",): 2,
        ("-m", "seed=1,2", f"dataset.tire=lf,{address}"): 2,
        tuple(own): 2,
    }
    at_once = {"AFTER_CALLS": ""}
    calls = [
        Call([*arguments, *QUICK, f"root={root}"], environment=at_once) for arguments in expected
    ]
    mirrored = ["tracking=mlflow"] if importlib.util.find_spec("mlflow") else []
    calls += [
        Call([*QUICK, *own, f"root={root}"], environment={"AFTER_CALLS": "x" * 3}),
        Call(["-m", "seed=1,2", *QUICK, *own, *mirrored, f"root={root}"]),
        *(Call([str(root)], "experiments.sync") for _ in mirrored),  # what a busy mirror left
        Call([str(root), "--no-profile"], "experiments.report"),
        Call([*QUICK, f"root={tmp_path}/{address}"]),
    ]
    ended = called(calls, {**os.environ, VARIABLE: environment, "AFTER_CALLS": "x" * 8})
    wrong = sum(end.code != code for end, code in zip(ended, expected.values(), strict=False))
    files = [path for path in root.rglob("*") if path.is_file()]
    stored = b"".join(str(path).encode() + path.read_bytes() for path in files)
    printed = "".join(end.out + end.err for end in ended) + _notebook(root, environment)
    found = [stored.count(canary.encode()) for canary in CANARIES]
    shown = [printed.count(canary) for canary in CANARIES]
    measured(
        f"{len(calls)} commands: {sum(found)} in {len(files)} files, {sum(shown)} printed, {wrong} "
        "exit codes differ"
    )
    assert len(files) > len(calls)
    assert bool(mirrored) == _tracked(root)
    assert not sum(found)
    assert not sum(shown)
    assert not wrong


def _tracked(root: Path) -> bool:
    """Whether the mirror holds something to search."""
    return (root / ".mlflow" / "mlflow.db").is_file()


def _notebook(root: Path, secret: str) -> str:
    """A notebook on these runs and all it shows, executed where the secret is known."""
    if not importlib.util.find_spec("nbclient"):
        return ""
    nbclient, nbformat = map(importlib.import_module, ("nbclient", "nbformat"))
    notebook = nbformat.read(CHECKOUT / "notebooks" / "read_a_sweep.ipynb", as_version=4)
    known = {VARIABLE: secret, "MIHO_RUNS": str(root), "PYTHONPATH": str(CHECKOUT)}
    nbclient.NotebookClient(
        notebook, timeout=60, allow_errors=True, extra_arguments=["--log-level=ERROR"]
    ).execute(env={**os.environ, **known})
    return str(nbformat.writes(notebook))
