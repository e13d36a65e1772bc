"""Digests of the code that a run uses, and versions of the packages that it uses."""

import sys
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import baselines
import miho
from experiments.app.closure import Sources
from experiments.app.parts import part_nodes
from experiments.app.safety import find_target
from miho import CurveFit, Dataset, Optimizer
from miho.fitting.joint_problem import Joint
from miho.models import Model
from miho.models.joint import parts_of
from miho.study import environment_stamp
from miho.study.identity import sha256
from miho.study.provenance import command_line

NUMERICAL = {"numpy", "scipy"}
WRAPPED = {name: name for name in ("optuna", "cmaes", "nevergrad", "dehb")} | {"dfols": "DFO-LS"}
"""Distributions of the libraries that methods wrap, by import name."""


def packages_of(method: object) -> dict[str, str]:
    """Versions of NumPy, SciPy and the libraries that the method wraps."""
    module = sys.modules.get(type(method).__module__)  # None for a file of the user
    names = vars(module).values() if module else ()
    tops = {str(getattr(x, "__module__", None) or getattr(x, "__name__", "")) for x in names}
    wrapped = {WRAPPED[name] for top in tops if (name := top.partition(".")[0]) in WRAPPED}
    return {name: _version(name) for name in sorted(NUMERICAL | wrapped)}


_version = cache(version)
"""Cached, because a lookup takes milliseconds."""


def code_of(setting: Mapping[str, Any], problem: CurveFit, optimizer: Optimizer) -> str:
    """Digest of the code that can affect the result of a run, including the user's files.

    It covers the modules of this run's parts and the modules that they import; of a method in a
    file of the user, the file and the modules of its base classes. A change of code that the run
    does not use leaves the digest unchanged.
    """
    parts = (problem, problem.model, problem.rho)
    modules = {type(part).__module__ for part in parts} | {"miho.optim.minimize"}
    modules |= {base.__module__ for base in type(optimizer).__mro__}
    for nodes in part_nodes(setting).values():
        for key, kind in (("model", Model), ("dataset", Dataset)):
            modules.add(find_target(nodes[key]["_target_"], kind).__module__)
    if setting["problem"]["parts"]:
        modules.add(Joint.__module__)
    code = our_code(frozenset(modules))
    models = [problem.model, *(part.model for part in parts_of(problem.model))]
    sources = dict.fromkeys(m.source for m in models if m.source is not None)
    if setting["optimizer"].get("path") is not None:
        sources[Path(setting["optimizer"]["path"])] = None
    texts = b"".join(source.read_bytes() for source in sources)
    return sha256(code.encode() + texts) if sources else code


@cache
def our_code(modules: frozenset[str]) -> str:
    """Digest of some modules of this project and of all modules that they import."""
    return SOURCES.digest(modules)


CACHE = Path(__file__).parent / "__pycache__" / "closure.json"
SOURCES = Sources(
    {package.__name__: Path(str(package.__file__)).parent for package in (miho, baselines)},
    cache=CACHE,
)


DRIVING = ("experiments.drive", "experiments.driving.laps")
"""Modules that, with their imports except plumbing and figures, determine the result of a drive."""


def regenerates(module: str, methods: Iterable[Optimizer]) -> dict[str, Any]:
    """Command, code and machine that are stored with the results of a drive."""
    return {
        "command": command_line(module),
        "code": driving_code(methods),
        "environment": environment_stamp(),
    }


def driving_code(methods: Iterable[Optimizer]) -> str:
    """Digest of the code that can affect a drive of a car that these methods identified."""
    modules = frozenset({type(method).__module__ for method in methods})
    return DRIVING_SOURCES.digest({*DRIVING, "miho.optim.minimize", *modules})


def tracking_code() -> str:
    """Digest of the code that can affect the score of a method that tracks parameters."""
    parts = ("task", "session", "comparison")
    return DRIVING_SOURCES.digest({f"experiments.online.{part}" for part in parts})


DRIVING_SOURCES = Sources(
    {package.__name__: Path(str(package.__file__)).parent for package in (miho, baselines)}
    | {"experiments": Path(__file__).parents[1]},
    excluded=("experiments.app", "miho.analysis", "miho.figures", "miho.study"),
    cache=CACHE,
)
