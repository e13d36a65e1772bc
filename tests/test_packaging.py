"""What is installed, and what the checkout holds."""

import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Mapping
from pathlib import Path

import pytest

from miho.core import machine

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel of the files that git tracks, built with the installed setuptools."""
    return built(tmp_path_factory.mktemp("wheel"), os.environ)


def built(folder: Path, environment: Mapping[str, str]) -> Path:
    """The wheel that is built in a folder."""
    archive = folder / "source.tar"
    subprocess.run(["git", "archive", "-o", archive, "HEAD"], cwd=ROOT, check=True)
    with tarfile.open(archive) as tar:
        tar.extractall(folder / "source", filter="data")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-index"]
    command += ["--no-build-isolation", "--wheel-dir", str(folder), str(folder / "source")]
    subprocess.run(command, check=True, capture_output=True, env=dict(environment))
    (wheel,) = folder.glob("*.whl")
    return wheel


@pytest.mark.slow
def test_the_wheel_contains_only_miho(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"miho"}
    assert "miho/py.typed" in names
    tires = {f"miho/vehicle/data/tires/{tire}.tir" for tire in ("lf", "rf", "lr", "rr")}
    assert tires <= set(names)
    pages = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "miho/analysis/pages/templates").iterdir()
    }
    assert pages
    assert pages <= set(names)
    sources = {path.relative_to(ROOT).as_posix() for path in (ROOT / "miho/core").glob("*.[ch]")}
    assert sources
    assert not sources & set(names), "the sdist has them"
    assert "miho/core/_machine.pyi" in names


@pytest.mark.slow
@pytest.mark.skipif(machine() is None, reason="there is no C compiler")
def test_one_wheel_with_the_machine_serves_all_pythons(wheel: Path) -> None:
    assert "-cp311-abi3-" in wheel.name
    assert any(name.startswith("miho/core/_machine.") and not name.endswith(".pyi")
               for name in zipfile.ZipFile(wheel).namelist())  # fmt: skip


@pytest.mark.slow
def test_without_a_compiler_the_wheel_is_for_any_machine_and_works(tmp_path: Path) -> None:
    """Without the machine; the fit takes its other road."""
    wheel = built(tmp_path, {**os.environ, "CC": str(tmp_path / "no compiler")})
    assert wheel.name.endswith("-py3-none-any.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "installed")
    program = (
        "import miho, miho.core, numpy as np;"
        "assert miho.core.machine() is None;"
        "x = np.linspace(0, 5, 50);"
        "f = lambda x, a, b: a * np.exp(-b * x);"
        "fit = miho.fit(f, x, f(x, 2.0, 1.5), {'a': (0, 10), 'b': (0, 10)}, compiled=False);"
        "print(*fit.theta)"
    )
    process = subprocess.run(
        [sys.executable, "-P", "-c", program],
        cwd=tmp_path,
        env={"PYTHONPATH": str(tmp_path / "installed")},
        capture_output=True,
        text=True,
        check=True,
    )
    assert [float(word) for word in process.stdout.split()] == pytest.approx([2.0, 1.5], rel=1e-6)


@pytest.mark.slow
def test_the_wheel_works_alone(wheel: Path, tmp_path: Path) -> None:
    """Without the checkout: the embedded tire is found and identified."""
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    program = (
        "import miho, miho.vehicle.data as d, miho.vehicle.models as m, pathlib, sys;"
        "p = lambda n, u, lo, hi: miho.Parameter(n, u, lo, hi);"
        "s = miho.Space((p('B','1/rad',2,40), p('C','-',1,2.5), p('D','N',1e3,9e3),"
        "p('Sx','rad',-.05,.05), p('Sy','N',-500,500)));"
        "f = miho.CurveFit(m.Pacejka(), d.sample_tir('lf'), s);"
        "r = miho.minimize(miho.MIHO(R=200), f);"
        "from miho.methods import LeastSquares, VariableProjection;"
        "q = [miho.minimize(method, f) for method in (LeastSquares(), VariableProjection())];"
        "assert pathlib.Path(miho.__file__).is_relative_to(sys.argv[1]), miho.__file__;"
        "print(*(run.loss ** 0.5 for run in (r, *q)))"
    )
    process = subprocess.run(
        [sys.executable, "-P", "-c", program, str(tmp_path)],
        cwd=tmp_path,
        env={"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    by_miho, *by_least_squares = map(float, process.stdout.split())
    assert by_miho < 450
    # Its noise is 400 N, of which a fit of five parameters takes a little.
    assert all(390 < error < by_miho for error in by_least_squares)


def test_the_package_list_names_only_miho() -> None:
    from setuptools import find_packages

    packages = find_packages(str(ROOT), include=["miho*"])
    assert {name.split(".")[0] for name in packages} == {"miho"}
    assert 'include = ["miho*"]' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def extras(command: str) -> set[str]:
    return {name for names in re.findall(r"\.\[([a-z,]+)\]", command) for name in names.split(",")}


@pytest.mark.parametrize(
    ("target", "expected"),
    [("install", {"experiments"}), ("compare", {"experiments"}), ("test", {"experiments", "dev"})],
)
def test_a_new_environment_holds_what_its_target_needs(
    target: str, expected: set[str], tmp_path: Path
) -> None:
    command = ["make", "--dry-run", target, f"VENV={tmp_path / 'new'}"]
    output = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert extras(output) == expected


def test_ci_installs_every_extra() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    commands = "".join(
        (ROOT / name).read_text(encoding="utf-8") for name in ("Makefile", ".ci/run")
    )
    assert extras(commands) == set(project["optional-dependencies"])


def test_the_sanitized_tests_have_what_they_import() -> None:
    """They run in a copy of some files: each module of the tests that one imports is among them."""
    script = (ROOT / ".ci/run").read_text(encoding="utf-8")
    command = re.search(r"(git ls-files .*?) \|", script, re.DOTALL)
    assert command is not None
    listed = command[1].replace("\\\n", "").replace("-T -", "").split()
    output = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    copied = output.split()
    assert "tests/core/test_search.py" in copied
    for name in copied:
        if name.startswith("tests/"):
            text = (ROOT / name).read_text(encoding="utf-8")
            for module in re.findall(r"^from (tests[.\w]*) import", text, re.MULTILINE):
                assert module.replace(".", "/") + ".py" in copied, f"{name} imports {module}"


def test_the_public_names() -> None:
    import miho

    promised = {
        "minimize", "Budget", "Space", "Parameter", "Problem", "LeastSquaresProblem", "CurveFit",
        "Oracle", "Optimizer", "AskTell", "MIHO", "load_tir", "load_runs",
    }  # fmt: skip
    assert promised <= set(miho.__all__)
