"""The gallery's pages show the code and the results of its examples."""

import re
from pathlib import Path

import pytest
from PIL import Image

from experiments.app.gallery_fmu import missing_for_fmu
from experiments.app.gallery_pages import FOLDER, NAMES, example_page, index_page, read_example
from experiments.gallery import run_example
from tests.printed import check_printed

LARGEST = 40_000
"""Bytes of a picture."""


def stored_page(name: str) -> str:
    return (FOLDER / f"{name}.md").read_text(encoding="utf-8")


def stored_text(name: str) -> str:
    """The printed result that the page shows."""
    return re.findall(r"```text\n(.*?)\n```\n", stored_page(name), re.DOTALL)[-1]


@pytest.mark.parametrize("name", NAMES)
def test_a_page_shows_the_present_example(name: str) -> None:
    """`python -m experiments.gallery NAME` writes the page again."""
    example = read_example(name)
    compile(example.code, f"{name}.py", "exec")
    assert example.question.endswith("?")
    assert "simulated" in example.text
    assert len((FOLDER / f"{name}.py").read_text(encoding="utf-8").splitlines()) <= 50
    assert stored_page(name) == example_page(example, stored_text(name))


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
    for suffix in ("py", "md", "png"):
        assert sorted(path.stem for path in FOLDER.glob(f"*.{suffix}") if path.stem != "index") == (
            sorted(NAMES)
        )
    menu = (FOLDER.parents[1] / "mkdocs.yml").read_text(encoding="utf-8")
    assert re.findall(r"- (?:.*: )?gallery/(\w+)\.md$", menu, re.MULTILINE) == ["index", *NAMES]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_an_example_prints_the_stored_result(name: str, tmp_path: Path) -> None:
    if name == "fmu" and (reason := missing_for_fmu()):
        pytest.skip(reason)
    printed = run_example(name, tmp_path)
    assert (tmp_path / f"{name}.png").is_file()
    check_printed(printed, stored_text(name))
