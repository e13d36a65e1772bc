"""What packages pass on, and that they import it where it is used."""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import miho
from experiments import REMOVED
from miho.moved import new_name

PACKAGES = ["miho", "baselines.problems", *(f"miho.{name}" for name in (
    "analysis", "data", "identification", "methods", "models", "online", "optim", "parallel",
    "study", "vehicle.data", "vehicle.driving", "vehicle.models"))]  # fmt: skip
HEAVY = [
    "matplotlib",
    "numba",
    "pandas",
    "seaborn",
    "scipy.constants",
    "scipy.optimize",
    "scipy.special",
]
UNUSED = (
    "baselines",
    "miho.analysis",
    "miho.compiled.gauss_newton_bracket",
    "miho.compiled.triangular",
    "miho.fitting.expensive_fit",
    "miho.fitting.named",
    "miho.fitting.printed_fit",
    "miho.fitting.prior_weight",
    "miho.fitting.progress",
    "miho.fitting.protocols",
    "miho.identification.constraints",
    "miho.identification.prior",
    "miho.identification.report",
    "miho.identification.robust_loss",
    "miho.identification.ties",
    "miho.identification.uncertainty",
    "miho.models.joint",
    "miho.models.plain_arithmetic",
    "miho.models.tied",
    "miho.models.trajectory",
    "miho.moved",
    "miho.optim.asynchronous_miho_gn",
    "miho.optim.gauss_newton_steps",
    "miho.optim.miho_qn",
    "miho.optim.pace",
    "miho.optim.schedule",
    "miho.optim.spread",
    "miho.parallel.journal",
    "miho.parallel.pool",
    "miho.parallel.usage",
    "miho.study",
    "miho.vehicle",
)
"""Modules that `miho.fit` of a function does not load, as the beginnings of their names."""
MOST_FILES, MOST_LINES = 60, 10_000
"""Largest numbers of files of the library that such a fit loads, and of their lines."""


@pytest.mark.parametrize("name", PACKAGES)
def test_all_that_a_package_lists_can_be_had(name: str) -> None:
    package = importlib.import_module(name)
    assert set(package.__all__) <= set(dir(package))
    for exported in package.__all__:
        assert hasattr(package, exported), exported


@pytest.mark.parametrize("name", PACKAGES)
def test_what_a_package_passes_on_is_not_called_as_a_module_of_it(name: str) -> None:
    """Once such a module is imported, by whomever, it would stand where the name did."""
    package = importlib.import_module(name)
    modules = {module.name for module in pkgutil.iter_modules(package.__path__)}
    at_once = {"minimize"} if name == "miho.optim" else set()  # imported by the package itself
    assert not modules & set(package.__all__) - at_once


def test_completion_lists_packages_and_no_means_of_import() -> None:
    assert {"analysis", "methods", "online", "testing", "vehicle"} <= set(dir(miho))
    assert not {"TYPE_CHECKING", "at_first_use"} & set(dir(miho))


def test_modules_are_attributes_and_nothing_else_is() -> None:
    assert (
        miho.vehicle.models.tire.Pacejka is importlib.import_module("miho.vehicle.models").Pacejka
    )
    with pytest.raises(AttributeError, match="module 'miho' has no attribute 'pacejka'"):
        miho.pacejka  # noqa: B018
    with pytest.raises(ImportError):
        exec("from miho.models import pacejka")


def test_a_removed_name_names_its_successor() -> None:
    with pytest.raises(ImportError, match="AsynchronousMIHO was removed; use AsynchronousMIHOGN"):
        exec("from miho.optim import AsynchronousMIHO")


def test_a_removed_command_names_its_successor() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"was removed; use miho\.load_runs"):
        importlib.import_module("experiments.export")
    for remedy in REMOVED.values():
        for name in re.findall(r"experiments[.\w]+", remedy):
            assert importlib.util.find_spec(name), name


@pytest.mark.parametrize(
    ("statement", "new"),
    [
        ("from miho.models import Pacejka", "miho.vehicle.models.Pacejka"),
        ("from miho.models.magic_formula import MagicFormula", "miho.vehicle.models.magic_formula"),
        ("import miho.identification.statement", "miho.identification.conclusion"),
        ("import miho.data; miho.data.load_axle_samples", "miho.vehicle.data.load_axle_samples"),
    ],
)
def test_a_former_name_is_answered_with_the_new_one(statement: str, new: str) -> None:
    with pytest.raises(ModuleNotFoundError, match=rf"^miho\.[\w.]+ is now {new}$"):
        exec(statement)
    home, _, name = new.rpartition(".")
    assert hasattr(importlib.import_module(home), name)


def test_the_former_package_of_driving_is_known() -> None:
    assert new_name("miho.driving") == "miho.vehicle.driving"
    assert new_name("miho.models.Model") is None


@pytest.mark.parametrize(
    "program",
    [
        "import miho",
        "import miho.analysis",
        "from miho import MIHO, MIHOGN, CurveFit, Dataset, Space, minimize",
        "import miho.data, miho.models, miho.vehicle.data, miho.vehicle.models; "
        "packages = miho.data, miho.models, miho.vehicle.data, miho.vehicle.models; "
        "[getattr(p, n) for p in packages for n in p.__all__]",
    ],
)
def test_what_takes_long_to_import_is_imported_where_it_is_used(program: str) -> None:
    listed = f"import sys; {program}; print([m for m in {HEAVY} if m in sys.modules])"
    process = subprocess.run(
        [sys.executable, "-c", listed], capture_output=True, text=True, check=True
    )
    assert process.stdout.strip() == "[]"


def test_a_plain_fit_loads_no_part_that_it_does_not_use() -> None:
    program = (
        "import sys, numpy, miho; t = numpy.arange(9.0); "
        "miho.fit(lambda t, a, b: a * numpy.exp(-b * t), t, numpy.exp(-t), "
        "{'a': (0, 5), 'b': (0, 10)}); "
        "print(*(m.__file__ for n, m in sys.modules.items() if n.startswith('miho')), sep='\\n'); "
        f"print([m for m in sys.modules if m.startswith({UNUSED})])"
    )
    process = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    *files, unused = process.stdout.splitlines()
    assert unused == "[]"
    texts = [Path(file).read_text(encoding="utf-8") for file in files if file.endswith(".py")]
    assert len(texts) <= MOST_FILES
    assert sum(len(text.splitlines()) for text in texts) <= MOST_LINES
