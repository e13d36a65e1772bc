"""What the README shows runs as it stands there."""

import re
import shutil
import sys
import types
from pathlib import Path

import pytest

from miho.data import embedded_tire

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


@pytest.mark.parametrize("block", BLOCKS, ids=range(len(BLOCKS)))
def test_python_blocks_run(block: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "runs" / "compare").mkdir(parents=True)
    shutil.copy(embedded_tire("lf"), tmp_path / "my.tir")
    monkeypatch.chdir(tmp_path)
    module = types.ModuleType("readme")
    monkeypatch.setitem(sys.modules, "readme", module)
    exec(compile(block, "README.md", "exec"), module.__dict__)


def test_links_and_names_exist() -> None:
    for target in re.findall(r"\]\((?!https:)([^)#]+)\)", README):
        assert (ROOT / target).exists(), target
    for name in re.findall(r"`(?:dataset=|optimizer=|space=)(\w+)", README):
        assert list((ROOT / "conf").glob(f"*/{name}.yaml")), name


def test_the_claims_are_the_measured_ones() -> None:
    table = (ROOT / "experiments/results/paper_fig6/claims.md").read_text(encoding="utf-8")
    assert table.partition("\n\n")[2].strip() in README
