"""What is compiled for a drive: its names, where it is called from, and how it is without numba."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import miho.quantities
import miho.vehicle.driving
from miho.vehicle.driving import compiling

FOLDER = Path(miho.vehicle.driving.__file__).parent
ABSENT = "driving needs numba: pip install 'miho[vehicle]'"


def test_an_edit_of_any_file_of_the_car_gives_another_name() -> None:
    files = [*sorted(FOLDER.glob("*.py")), Path(miho.quantities.__file__)]
    digests = {compiling._digest()}
    texts = {file: file.read_bytes() for file in files}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "read_bytes", lambda file: texts[file])
        for file in files:
            text, texts[file] = texts[file], texts[file] + b"#"
            compiling._digest.cache_clear()
            digests.add(compiling._digest())
            texts[file] = text
    compiling._digest.cache_clear()
    assert len(digests) == 1 + len(files)
    assert compiling._digest() in digests


def test_what_is_compiled_comes_from_the_files_of_the_digest() -> None:
    """And from NumPy and the standard library, whose versions numba's cache does not know."""
    seen = 0
    for path in FOLDER.glob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        origin = {
            alias.name: str(node.module)
            for node in tree.body
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        for node in ast.walk(tree):
            if not isinstance(node, ast.FunctionDef):
                continue
            decorators = {d.id for d in node.decorator_list if isinstance(d, ast.Name)}
            if not decorators & {"compiled", "part"} or path.name == "compiling.py":
                continue
            seen += 1
            nodes = [inner for line in node.body for inner in ast.walk(line)]
            used = {inner.id for inner in nodes if isinstance(inner, ast.Name)}
            for module in (origin[name] for name in used & origin.keys()):
                ours = module.startswith("miho.vehicle.driving.") or module == "miho.quantities"
                assert ours or module == "math", f"{path.name}: {module}"
    assert seen == 44


def without_numba(program: str) -> subprocess.CompletedProcess[str]:
    """A program in a process that cannot import numba."""
    hidden = f"import sys; sys.modules['numba'] = None\n{program}"
    return subprocess.run([sys.executable, "-c", hidden], capture_output=True, text=True)


def test_without_numba_all_can_be_imported_and_a_call_says_what_is_missing() -> None:
    """What runs as Python's does so."""
    ended = without_numba("""
import pkgutil
import miho, miho.vehicle.driving as d
from importlib import import_module
for module in pkgutil.walk_packages(d.__path__, "miho.vehicle.driving."):
    import_module(module.name)
[getattr(d, name) for name in d.__all__]
from miho.vehicle.driving.road import PLANE, place_at
print(*place_at(PLANE, 12.0, 1.0))
d.lvms()
""")
    assert ended.stdout == "12.0 1.0 0.0\n"
    assert ended.stderr.splitlines()[-1].endswith(f"MissingNumbaError: {ABSENT}")


@pytest.mark.parametrize(
    "arguments",
    [
        ["drive", "experiment=ims_obstacle"],
        ["drive_study", "experiment=identification_buys"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_commands_that_drive_say_in_one_line_that_numba_is_missing(
    arguments: list[str], tmp_path: Path
) -> None:
    name, *settings = arguments
    ended = without_numba(
        f"import runpy; sys.argv = {['x', *settings, f'root={tmp_path}']}\n"
        f"runpy.run_module('experiments.{name}', run_name='__main__')"
    )
    (line,) = ended.stderr.splitlines()
    assert line.startswith("error: ")
    assert line.endswith(ABSENT)
    assert ended.returncode == 2
