"""What the README and the manual show runs as it stands there, and what they name exists."""

import re
import shutil
import sys
import types
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import cloudpickle
import pytest

from experiments.app.options import groups_of, options_of
from miho.vehicle.data import embedded_tire
from tests.printed import check_printed

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
API = sorted(DOCS.glob("api/*.md"))
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md")), *API]
LONG = {"evidence.md"}
"""Pages whose Python takes minutes."""
SECONDS = {
    "add-a-method.md", "compare-models.md", "fit.md", "next-measurement.md", "trajectories.md",
}  # fmt: skip
"""Pages whose Python takes seconds; the README's shows whether an installation works."""
NEEDS = {"posterior.md": ("arviz", "emcee")}
"""Libraries of an extra that the Python of a page needs."""
BLOCK = re.compile(r"```python\n(?P<code>.*?)```(?:\n\n```text\n(?P<printed>.*?)\n```)?", re.DOTALL)
"""Python, and the text that it prints if a block of text follows."""
BLOCKS = [
    pytest.param(
        found["code"],
        found["printed"],
        id=f"{page.name}-{number}",
        marks=[
            *([pytest.mark.slow] if page.name in SECONDS else []),
            pytest.mark.filterwarnings(r"ignore:\s*ArviZ is undergoing:FutureWarning"),
            *(
                pytest.mark.skipif(find_spec(library) is None, reason=f"{library} is not installed")
                for library in NEEDS.get(page.name, ())
            ),
        ],
    )
    for page in PAGES
    if page.name not in LONG
    for number, found in enumerate(BLOCK.finditer(page.read_text(encoding="utf-8")))
]


@pytest.mark.parametrize(("code", "printed"), BLOCKS)
def test_python_blocks_run_and_print_the_text_after_them(
    code: str,
    printed: str | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "runs" / "compare").mkdir(parents=True)
    shutil.copy(embedded_tire("lf"), tmp_path / "my.tir")
    monkeypatch.chdir(tmp_path)
    module = types.ModuleType("readme")
    monkeypatch.setitem(sys.modules, "readme", module)
    cloudpickle.register_pickle_by_value(module)  # as functions of a main file are sent to workers
    try:
        exec(compile(code, "README.md", "exec"), module.__dict__)
    finally:
        cloudpickle.unregister_pickle_by_value(module)
    if printed is not None:
        check_printed(capsys.readouterr().out, printed)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_and_names_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target, anchor in re.findall(r"\]\((?!https:)([^)#]*)#?([^)]*)\)", text):
        linked = page.parent / target if target else page
        assert linked.exists(), target
        if linked.parent.name == "api":
            assert not anchor or anchor.rpartition(".")[2] in documented(linked), anchor
        elif anchor:
            titles = re.findall(r"^#+ (.*)", linked.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in {re.sub(r"\W+", "-", title.lower()).strip("-") for title in titles}
    for name in re.findall(r"`?(?:dataset|optimizer|space|problem)=([a-z][\w/]*)(?![\w.*])", text):
        options = [option for group in groups_of() for option in options_of(group)]
        assert name in {"null", "halving"} or any(o.startswith(name) for o in options), name
    for module in re.findall(r"python -m (experiments[\w.]*)", text):
        parts = module.split(".")
        place = ROOT.joinpath(*parts)
        assert place.is_dir() or place.with_suffix(".py").is_file(), module


def documented(page: Path) -> list[str]:
    """The names on a page of the API, in the order of the page."""
    return re.findall(r"^        - (\w+)$", page.read_text(encoding="utf-8"), re.MULTILINE)


def test_the_api_documents_every_public_name_once() -> None:
    packages = {page: re.findall(r"^::: (.+)$", page.read_text(), re.MULTILINE)[0] for page in API}
    public = {page: set(import_module(name).__all__) for page, name in packages.items()}
    names = [(page, name) for page in API for name in documented(page)]
    assert all(name in public[page] for page, name in names)
    assert sorted(name for _, name in names) == sorted(set().union(*public.values()))


def test_the_manual_lists_every_page() -> None:
    pages = re.findall(r": ([\w/-]+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE)
    found = [*DOCS.glob("*.md"), *API, *DOCS.glob("gallery/*.md")]
    assert sorted(pages) == sorted(path.relative_to(DOCS).as_posix() for path in found)
    listed = re.findall(r"\]\(([\w/-]+\.md)\)", (DOCS / "llms.txt").read_text(encoding="utf-8"))
    assert sorted(listed) == sorted(pages)
    notebooks = re.findall(r": notebooks/(\w+\.ipynb)$", (ROOT / "mkdocs.yml").read_text(), re.M)
    assert sorted(notebooks) == sorted(path.name for path in (ROOT / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("table_of", ["paper_fig6/claims", "paper_readings/readings"])
def test_the_claims_are_the_measured_ones(table_of: str) -> None:
    table = (DOCS / f"results/{table_of}.md").read_text(encoding="utf-8")
    assert table.partition("\n\n")[2].strip() in (DOCS / "results.md").read_text(encoding="utf-8")
