"""Which code a run uses: found by reading imports, in copies that may be changed."""

import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

import baselines
import miho
from experiments.app.closure import Sources

PACKAGES = {package.__name__: Path(str(package.__file__)).parent for package in (miho, baselines)}
RUN = (
    "miho.identification.curve_fit", "miho.optim.minimize", "miho.vehicle.models.tire",
    "miho.vehicle.data.tir_sampling", "miho.methods.least_squares",
)  # fmt: skip
PART = ("miho.optim.minimize",)


@pytest.fixture(scope="module")
def roots(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Our packages, to be changed."""
    copies = {name: tmp_path_factory.mktemp("copies") / name for name in PACKAGES}
    for name, folder in PACKAGES.items():
        for path in (*folder.rglob("*.py"), *folder.rglob("*.[ch]")):
            copy = copies[name] / path.relative_to(folder)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, copy)
    return copies


@pytest.fixture(scope="module")
def cache(roots: dict[str, Path]) -> Path:
    """A file for what was read, so that each test reads only what it changes."""
    return roots["miho"].parent / "cache" / "closure.json"


@pytest.fixture(scope="module")
def before(roots: dict[str, Path], cache: Path) -> str:
    """The digest of the run's code before any change."""
    return Sources(roots, cache=cache).digest(RUN)


@contextmanager
def appended(path: Path, text: str) -> Iterator[None]:
    """A file that has more for a while."""
    before = path.read_text() if path.exists() else None
    path.write_text((before or "") + text)
    yield
    path.unlink() if before is None else path.write_text(before)


def test_code_that_a_run_does_not_use_may_change(
    roots: dict[str, Path], cache: Path, before: str
) -> None:
    with ExitStack() as changes:
        for place in (
            "data/mat.py",
            "methods/tiktak.py",
            "vehicle/models/engine.py",
            "study/store.py",
        ):
            changes.enter_context(appended(roots["miho"] / place, "\nCHANGED = 1\n"))
        another = roots["baselines"] / "another.py"
        changes.enter_context(appended(another, "from miho.optim import Optimizer\n"))
        assert Sources(roots, cache=cache).digest(RUN) == before


@pytest.mark.parametrize(
    "place",
    ["optim/oracle.py", "optim/space.py", "compiled/taped.py", "identification/residuals.py",
     "compiled/fit.py", "core/elementary.h", "vehicle/models/tire.py", "methods/descent.py",
     "data/dataset.py"],
)  # fmt: skip
def test_one_constant_of_what_it_uses_may_not(
    roots: dict[str, Path], cache: Path, before: str, place: str
) -> None:
    with appended(roots["miho"] / place, "\nCHANGED = 1\n"):
        assert Sources(roots, cache=cache).digest(RUN) != before


def test_hidden_c_files_and_line_endings_change_no_digest(
    roots: dict[str, Path], cache: Path, before: str
) -> None:
    """An editor's lock is a hidden link to nothing, and Git may write lines for Windows."""
    header = roots["miho"] / "core" / "elementary.h"
    text, hidden = header.read_bytes(), [header.with_name(x) for x in (".#a.h", "._a.c")]
    try:
        hidden[0].symlink_to("nothing")
        hidden[1].write_bytes(b"\0")
        header.write_bytes(text.replace(b"\n", b"\r\n"))
        assert Sources(roots, cache=cache).digest(RUN) == before
    finally:
        header.write_bytes(text)
        for path in hidden:
            path.unlink(missing_ok=True)


def test_what_was_read_is_kept_and_never_of_another_text(
    roots: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.dont_write_bytecode", False)
    cache, place = tmp_path / "cache" / "closure.json", roots["miho"] / "optim" / "oracle.py"
    before = Sources(roots).digest(PART)
    assert Sources(roots, cache=cache).digest(PART) == before
    written = cache.read_bytes()
    with monkeypatch.context() as context:
        context.setattr("experiments.app.closure.ast.parse", None)
        assert Sources(roots, cache=cache).digest(PART) == before
    times = place.stat()
    with appended(place, "\nCHANGED = 1\n"):
        os.utime(place, ns=(times.st_atime_ns, times.st_mtime_ns))
        changed = Sources(roots).digest(PART)
        assert changed != before
        assert Sources(roots, cache=cache).digest(PART) == changed
    for damaged in (written[:-1], b"", written.replace(b"oracle", b"orache")):
        cache.write_bytes(damaged)
        assert Sources(roots, cache=cache).digest(PART) == before
        assert cache.read_bytes() == written
    assert Sources(roots, cache=place / "closure.json").digest(PART) == before


def test_comments_and_docstrings_may_change(
    roots: dict[str, Path], cache: Path, before: str
) -> None:
    with appended(roots["miho"] / "optim" / "oracle.py", "\n# a comment\n"):
        assert Sources(roots, cache=cache).digest(RUN) == before


def test_a_name_leads_to_the_module_that_defines_it(tmp_path: Path) -> None:
    files = {
        "p/__init__.py": "from p.a import f\nfrom p.b import g as h\nfrom .inner import deep\n",
        "p/a.py": "def f():\n    from p.late import x\n",
        "p/b.py": "import p.c\ng = 1\n",
        "p/c.py": "import numpy\nfrom os import path\n",
        "p/late.py": "x = 1\n",
        "p/unused.py": "",
        "p/inner/__init__.py": "from .deep import deep\n",
        "p/inner/deep.py": "from .. import late\nfrom ..c import *\ndeep = 1\n",
        "user.py": "",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    for text, used in (
        ("from p import f", ["p.a", "p.late"]),
        ("from p import h", ["p.b", "p.c"]),
        ("from p import a as other", ["p.a", "p.late"]),
        ("from p import deep", ["p.c", "p.inner.deep", "p.late"]),
        ("import p.b", ["p.b", "p.c"]),
        ("from p import *", ["p", "p.a", "p.b", "p.c", "p.inner.deep", "p.late"]),
        ("import numpy", []),
    ):
        (tmp_path / "q.py").write_text(text)
        sources = Sources({"p": tmp_path / "p", "q": tmp_path / "q"})
        assert sources.closure(["q"]) == sorted([*used, "q"]), text


def test_packages_that_count_for_nothing_are_not_followed(tmp_path: Path) -> None:
    """So the plumbing of commands is no part of what a drive comes to, but the commands are."""
    place = tmp_path / "top"
    (place / "app").mkdir(parents=True)
    for name, text in {
        "__init__": "", "drive": "import top.app.console, top.car", "car": "", "other": "",
        "app/__init__": "", "app/console": "import top.other",
    }.items():  # fmt: skip
        (place / f"{name}.py").write_text(text)
    whole, part = Sources({"top": place}), Sources({"top": place}, excluded=["top.app"])
    assert "top.other" in whole.closure(["top.drive"])
    assert part.closure(["top.drive"]) == ["top.car", "top.drive"]
