"""The layers: who may import whom, read from the imports themselves."""

import ast
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
NUMERICS = {"numpy", "scipy"}
TABLES = {"pandas", "seaborn", "matplotlib"}

# package: (ours it may import, third-party packages it may import); a part before its whole
LAYERS: dict[str, tuple[set[str], set[str]]] = {
    "miho.core": ({"miho.core"}, {"numpy"}),
    "miho.compiled": ({"miho.compiled", "miho.core"}, {"numpy"}),
    "miho.optim": ({"miho.compiled", "miho.optim", "miho.parallel"}, NUMERICS),
    "miho.parallel": (
        {"miho.parallel"},
        {"numpy", "orjson", "cloudpickle", "dask", "dask_jobqueue", "distributed"},
    ),
    "miho.models": (
        {"miho.core", "miho.compiled", "miho.models", "miho.parallel"},
        NUMERICS | {"fmpy"},
    ),
    "miho.data": ({"miho.data", "miho.models"}, NUMERICS | {"pooch"}),
    "miho.identification": (
        {
            "miho.identification",
            "miho.compiled",
            "miho.optim",
            "miho.models",
            "miho.data",
            "miho.parallel",
        },
        NUMERICS | TABLES | {"emcee", "arviz"},
    ),
    "miho.online": (
        {
            "miho.core",
            "miho.online",
            "miho.compiled",
            "miho.optim",
            "miho.models",
            "miho.data",
            "miho.identification",
        },
        NUMERICS,
    ),
    "miho.vehicle.models": (
        {"miho.vehicle.models", "miho.models", "miho.compiled", "miho.data", "miho.optim"},
        NUMERICS,
    ),
    "miho.vehicle.data": (
        {"miho.vehicle.data", "miho.vehicle.models", "miho.data", "miho.models"},
        NUMERICS | {"pooch"},
    ),
    "miho.vehicle.driving.assembly": (
        {
            "miho.vehicle.driving.assembly",
            "miho.vehicle.driving",
            "miho.vehicle.models",
            "miho.vehicle.data",
            "miho.identification",
            "miho.optim",
            "miho.models",
            "miho.data",
            "miho.study",
        },
        NUMERICS,
    ),
    "miho.vehicle.driving": (
        {
            "miho.online",
            "miho.vehicle.driving",
            "miho.vehicle.models",
            "miho.vehicle.data",
            "miho.models",
            "miho.data",
        },
        NUMERICS | {"numba"},
    ),
    "miho.vehicle": (set(), set()),
    "miho.study": (
        {"miho.core", "miho.study", "miho.optim", "miho.parallel"},
        {"pandas", "filelock", "numpy", "orjson", "threadpoolctl"},
    ),
    "miho.figures": ({"miho.figures"}, NUMERICS | TABLES),
    "miho.analysis.pages": (
        {
            "miho.analysis",
            "miho.figures",
            "miho.analysis.pages",
            "miho.study",
            "miho.identification",
            "miho.models",
        },
        NUMERICS | TABLES | {"jinja2", "markupsafe", "pooch", "vl_convert"},
    ),
    "miho.analysis": ({"miho.analysis", "miho.figures", "miho.study"}, NUMERICS | TABLES),
    "miho.fitting": (
        {
            "miho.core",
            "miho.fitting",
            "miho.identification",
            "miho.methods",
            "miho.optim",
            "miho.models",
            "miho.data",
            "miho.figures",
            "miho.parallel",
        },
        NUMERICS | TABLES,
    ),
    "miho.methods": ({"miho.methods", "miho.optim"}, NUMERICS),
    "miho.testing": ({"miho.testing", "miho.optim", "miho.models"}, NUMERICS),
    "baselines.problems": (
        {"baselines.problems", "miho.compiled", "miho.models", "miho.data"},
        {"numpy"},
    ),
    "baselines.arena": (
        {"baselines.arena", "miho.analysis", "miho.figures", "miho.study"},
        NUMERICS | TABLES,
    ),
    "baselines.online": (
        {
            "baselines.online",
            "miho.online",
            "miho.optim",
            "miho.models",
            "miho.vehicle.models",
            "miho.data",
            "miho.identification",
        },
        {"numpy"},
    ),
    "baselines": (
        {"baselines", "miho.compiled", "miho.methods", "miho.optim"},
        NUMERICS | {"optuna", "cmaes", "nevergrad", "dehb", "dfols", "loguru"},
    ),
}
SHARED = {
    "miho.exports", "miho.moved", "miho.quantities", "miho.radial_map",
    "miho.regular_file", "miho.units", "miho.validate",
}  # fmt: skip
"""Below all layers: anyone may import them, and they import nobody but NumPy."""
CORE = {
    f"miho.{name}"
    for name in (
        "compiled", "core", "data", "figures", "fitting", "identification", "models",
        "online", "optim", "parallel", "testing",
    )
}  # fmt: skip
"""The layers of the core, which know neither vehicles nor rivals nor stored runs."""
CONCRETE = {"MIHO", "RandomSearch"}


def layer_of(module: str) -> str:
    return next(
        (
            layer
            for layer in (*LAYERS, *SHARED)
            if module == layer or module.startswith(layer + ".")
        ),
        "",
    )


def modules() -> list[Path]:
    files = sorted((ROOT / "miho").rglob("*.py")) + sorted((ROOT / "baselines").rglob("*.py"))
    return [path for path in files if path != ROOT / "miho" / "__init__.py"]


def imports(path: Path) -> list[tuple[str, list[str]]]:
    """Absolute module names that a file imports, with the names taken from them."""
    modules_and_names = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules_and_names += [(alias.name, []) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            modules_and_names.append((node.module or "", [alias.name for alias in node.names]))
    return modules_and_names


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_layers_hold(path: Path) -> None:
    module_name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    layer = layer_of(module_name)
    assert layer, f"{module_name} belongs to no layer"
    allowed, others = LAYERS.get(layer, (set(), {"numpy"}))
    allowed = allowed | SHARED
    for module, names in imports(path):
        top = module.partition(".")[0]
        if top in sys.stdlib_module_names:
            continue
        if path.name == "__init__.py" and module.startswith(f"{module_name}."):
            continue  # the front of a package names what lies in any of its rooms
        if top in {"miho", "baselines"}:
            assert layer_of(module) in allowed, f"{module_name} imports {module}"
            if layer == "miho.study":
                assert not CONCRETE & set(names), f"{module_name} imports a concrete optimizer"
        else:
            assert top in others, f"{module_name} imports {module}"


def test_the_core_is_below_vehicle_bench_and_workbench() -> None:
    for layer in CORE:
        assert LAYERS[layer][0] <= CORE | {"miho.methods"}, layer


def test_only_experiments_know_hydra() -> None:
    for path in modules():
        tops = {module.partition(".")[0] for module, _ in imports(path)}
        assert not tops & {"hydra", "omegaconf"}, path


def test_commands_are_thin_and_import_no_other_command() -> None:
    commands = sorted((ROOT / "experiments").glob("*.py"))
    names = {f"experiments.{path.stem}" for path in commands}
    for path in commands:
        assert len(path.read_text(encoding="utf-8").splitlines()) <= 90, path
    for path in (ROOT / "experiments").rglob("*.py"):
        assert not names & {module for module, _ in imports(path)}, path


def test_the_library_draws_without_global_state() -> None:
    for path in modules():
        assert "matplotlib.pyplot" not in {module for module, _ in imports(path)}, path


def test_no_grab_bag_modules() -> None:
    names = {path.stem for path in modules()}
    assert not names & {"utils", "util", "helpers", "common", "misc"}


def test_durations_come_from_a_monotone_clock() -> None:
    for path in [*modules(), *(ROOT / "experiments").rglob("*.py")]:
        assert "time.time(" not in path.read_text(encoding="utf-8"), path
