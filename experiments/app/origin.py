"""Digests of the code that a run uses, and versions of the packages that it uses."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import baselines
import miho
from experiments.app.parts import part_nodes
from experiments.app.safety import find_target
from miho.data import Dataset
from miho.fitting.joint_problem import Joint
from miho.identification import CurveFit
from miho.models import Model
from miho.models.joint import parts_of
from miho.optim import Optimizer
from miho.study import environment_stamp
from miho.study.closure import Sources
from miho.study.identity import sha256
from miho.study.provenance import command_line

NUMERICAL = {"numpy", "scipy"}
WRAPPED = {name: name for name in ("optuna", "cmaes", "nevergrad", "dehb")} | {"dfols": "DFO-LS"}
"""Distributions of the libraries that methods wrap, by the name that they are imported by."""


def packages_of(optimizer: Optimizer) -> dict[str, str]:
    """Versions of the packages that decide what a run finds: the numerical ones, the method's."""
    names = vars(sys.modules[type(optimizer).__module__]).values()
    tops = {str(getattr(x, "__module__", None) or getattr(x, "__name__", "")) for x in names}
    wrapped = {WRAPPED[name] for top in tops if (name := top.partition(".")[0]) in WRAPPED}
    return {name: _version(name) for name in sorted(NUMERICAL | wrapped)}


_version = cache(version)
"""Looking a version up takes milliseconds."""


def code_of(setting: Mapping[str, Any], problem: CurveFit, optimizer: Optimizer) -> str:
    """Digest of the code that decides what a run finds, the model's own file included.

    It is that of the parts of this run and of what they import: code that a run does not use may
    change without making its result one of other code.
    """
    parts = (problem, problem.model, problem.rho, optimizer)
    modules = {type(part).__module__ for part in parts} | {"miho.optim.minimize"}
    for nodes in part_nodes(setting).values():
        for key, kind in (("model", Model), ("dataset", Dataset)):
            modules.add(find_target(nodes[key]["_target_"], kind).__module__)
    if setting["problem"]["parts"]:
        modules.add(Joint.__module__)
    code = our_code(frozenset(modules))
    models = [problem.model, *(part.model for part in parts_of(problem.model))]
    sources = dict.fromkeys(m.source for m in models if m.source is not None)
    texts = b"".join(source.read_bytes() for source in sources)
    return sha256(code.encode() + texts) if sources else code


@cache
def our_code(modules: frozenset[str]) -> str:
    """Digest of some modules of ours and of all that they use."""
    return SOURCES.digest(modules)


CACHE = Path(__file__).parent / "__pycache__" / "closure.json"
SOURCES = Sources(
    {package.__name__: Path(str(package.__file__)).parent for package in (miho, baselines)},
    cache=CACHE,
)


DRIVING = ("experiments.drive", "experiments.driving.laps")
"""Whose files decide what a drive comes to, with all that they use but plumbing and figures."""


def regenerates(module: str, methods: Iterable[Optimizer]) -> dict[str, Any]:
    """What stands beside the results of a drive: its command, the code and the machine."""
    return {
        "command": command_line(module),
        "code": driving_code(methods),
        "environment": environment_stamp(),
    }


def driving_code(methods: Iterable[Optimizer]) -> str:
    """Digest of the code that decides what a drive comes to, whose car these methods identify."""
    modules = frozenset({type(method).__module__ for method in methods})
    return DRIVING_SOURCES.digest({*DRIVING, "miho.optim.minimize", *modules})


DRIVING_SOURCES = Sources(
    {package.__name__: Path(str(package.__file__)).parent for package in (miho, baselines)}
    | {"experiments": Path(__file__).parents[1]},
    excluded=("experiments.app", "miho.analysis", "miho.study"),
    cache=CACHE,
)
