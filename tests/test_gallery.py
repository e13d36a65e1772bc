"""The gallery's pages hold the code and the results of its examples."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from experiments.app.gallery_pages import FOLDER, NAMES, index_page, missing_for_fmu, read_example
from experiments.gallery import run_example
from tests.printed import check_printed

ROOT = Path(__file__).parents[1]
LARGEST = 40_000
"""Bytes of a picture."""


def stored_page(name: str) -> str:
    return (FOLDER / f"{name}.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", NAMES)
def test_a_page_has_all_parts(name: str) -> None:
    example = read_example(name)
    compile(example.code, f"{name}.py", "exec")
    assert example.question.endswith("?")
    assert "simulated" in example.text
    assert len(example.code.splitlines()) <= 45
    assert stored_page(name) == example.page


@pytest.mark.parametrize("command", [["check"], ["format", "--check"]], ids=" ".join)
def test_the_code_of_the_pages_is_formatted_and_has_no_fault(
    command: list[str], tmp_path: Path
) -> None:
    """By the settings of the project, which sort the imports of `miho` last."""
    pytest.importorskip("ruff")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    folder = tmp_path / "docs" / "gallery"
    folder.mkdir(parents=True)
    (tmp_path / "miho").symlink_to(ROOT / "miho")
    for name in NAMES:
        (folder / f"{name}.py").write_text(read_example(name).code + "\n", encoding="utf-8")
    ended = subprocess.run(
        [sys.executable, "-m", "ruff", *command, "--no-cache", str(folder)],
        capture_output=True, text=True, cwd=tmp_path,
    )  # fmt: skip
    assert not ended.returncode, ended.stdout


@pytest.mark.parametrize("name", NAMES)
def test_a_picture_is_small(name: str) -> None:
    path = FOLDER / f"{name}.png"
    assert path.stat().st_size <= LARGEST
    with Image.open(path) as picture:
        assert picture.size == pytest.approx((700, 400), abs=5)


@pytest.mark.parametrize("name", [*NAMES, "index"])
def test_links_of_a_page_exist(name: str) -> None:
    for target, anchor in re.findall(r"\]\((?!https:)([^)#]*)#?([^)]*)\)", stored_page(name)):
        linked = FOLDER / target
        assert linked.exists(), target
        if anchor:
            titles = re.findall(r"^#+ (.*)", linked.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in {re.sub(r"\W+", "-", title.lower()).strip("-") for title in titles}


def test_the_index_shows_every_example() -> None:
    assert stored_page("index") == index_page()
    for suffix in ("md", "png"):
        assert sorted(path.stem for path in FOLDER.glob(f"*.{suffix}") if path.stem != "index") == (
            sorted(NAMES)
        )
    menu = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert re.findall(r"- (?:.*: )?gallery/(\w+)\.md$", menu, re.MULTILINE) == ["index", *NAMES]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_an_example_prints_the_stored_result(name: str, tmp_path: Path) -> None:
    if name == "fmu" and (reason := missing_for_fmu()):
        pytest.skip(reason)
    printed = run_example(name, tmp_path)
    assert (tmp_path / f"{name}.png").is_file()
    check_printed(printed, read_example(name).printed)
