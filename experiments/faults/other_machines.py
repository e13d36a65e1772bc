"""R26: the same run by other Pythons, with other threads, hash seeds, locales and kernels."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

from experiments.faults.called import Call, called
from experiments.faults.identifying import CHECKOUT, TINY
from experiments.faults.row import Row
from miho.study import load_runs
from miho.study.environment import ARITHMETIC

VERSIONS = ("3.11", "3.12", "3.13", "3.14")
DIGEST = """
import hashlib, pathlib, runpy, sys
meaning = runpy.run_path("miho/study/meaning.py")["meaning"]
files = sorted(pathlib.Path("miho").rglob("*.py"))
print(hashlib.sha256("".join(meaning(file.read_bytes()) for file in files).encode()).hexdigest())
"""
SURROUNDINGS = {
    "as it is": {},
    "2 threads": {"OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2", "PYTHONHASHSEED": "1"},
    "locale C": {"LC_ALL": "C", "PYTHONHASHSEED": "2", "OPENBLAS_NUM_THREADS": "1"},
    "kernel Prescott": {"OPENBLAS_CORETYPE": "Prescott"},
}


def other_machines(folder: Path) -> Row:
    """The digest of all code by each Python here; one run in other surroundings."""
    digests = {version: digest for version in VERSIONS if (digest := _digest(version))}
    found = {name: _run(folder / name, more) for name, more in SURROUNDINGS.items()}
    usual = found["as it is"]
    identities = {one[0] for one in found.values()}
    alike = [one for one in found.values() if one[2] == usual[2]]
    equal = sum(one[1] == usual[1] for one in alike)
    told = len({str(one[2]) for one in found.values()})
    return Row(
        "R26",
        "other Pythons; 1 or 2 threads, hash seeds, locales, another kernel of BLAS",
        "one identity; bit-equal where CPU and kernel agree, recorded where not",
        f"{len(set(digests.values()))} digest by {', '.join(digests)}; {len(identities)} identity "
        f"of {len(found)} runs; {equal} of {len(alike)} on the same kernel equal bit for bit; "
        f"{told} kernels recorded",
        len(set(digests.values())) == len(identities) == 1 and equal == len(alike) > 2,
    )


def _digest(version: str) -> str | None:
    """By the Python of this version, if one is installed, beside those of pyenv as well."""
    beside = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    places = [*map(str, sorted(beside.glob(f"{version}.*/bin/python")))]
    python = places[0] if places else shutil.which(f"python{version}")
    if python is None:
        return None
    done = subprocess.run(
        [python, "-I", "-c", DIGEST], cwd=CHECKOUT, capture_output=True, text=True, check=False
    )
    return done.stdout.strip() or None


def _run(root: Path, more: dict[str, str]) -> tuple[str, object, list[object]]:
    """Identity, error over evaluations, and what the run says of its arithmetic."""
    call = Call(["-m", *TINY, "optimizer=least_squares", f"root={root}"])
    (ended,) = called([call], {**os.environ, **more})
    if ended.code:
        raise RuntimeError(ended.err)
    runs = load_runs(root)
    environment = json.loads(next(root.rglob("environment.json")).read_bytes())
    curve = runs.curves[["evaluations", "error"]].to_numpy().tolist()
    return runs.runs["id"].item(), curve, [environment[name] for name in ARITHMETIC]
