"""R17: a sweep that goes on after something it is made of has changed."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from miho.study import load_runs
from tests.faults.commands import CHECKOUT, TINY, Call, called
from tests.faults.conftest import Figures

PARTS = ("miho", "baselines", "experiments", "conf", "tests")
CSV = "alpha,Fy\n" + "".join(f"{x / 100},{-2000 * x / 100 + 3 * (x % 3)}\n" for x in range(-30, 31))


@pytest.mark.slow
@pytest.mark.fault(
    row="R17",
    fault="code, settings or data change before a sweep goes on",
    promise="exit 5 says what changed, fresh=true starts anew, comments count for nothing",
)
def test_changes(tmp_path: Path, measured: Figures) -> None:
    """Change a comment, the code, the settings, the data; then start afresh."""
    checkout, data = tmp_path / "checkout", tmp_path / "data.csv"
    for part in PARTS:
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(CHECKOUT / part, checkout / part, ignore=ignored)
    method = checkout / "miho/optim/random_search.py"
    settings = checkout / "conf/optimizer/random.yaml"
    commented = method.read_text(encoding="utf-8") + "\n# a comment\n"
    edited = re.sub(r"(?m)^batch: .*$", "batch: 7", settings.read_text(encoding="utf-8"))
    root = tmp_path / "runs"
    sweep = [
        "-m", *TINY[:2], "seed=0,1", f"root={root}", "dataset=csv", f"dataset.path={data}",
    ]  # fmt: skip
    fresh = [*sweep, "fresh=true"]
    steps = {
        # step: (exit code, call)
        "first": (0, Call(sweep, files={str(data): CSV})),
        "comment": (0, Call(sweep, files={str(method): commented})),
        "code": (5, Call(sweep, files={str(method): f"{commented}\nCHANGED = True\n"})),
        "fresh": (0, Call(fresh)),
        "settings": (5, Call(sweep, files={str(settings): edited})),
        "data": (0, Call(fresh, files={str(data): CSV + "0.31,-620\n"})),
    }
    ended = dict(zip(steps, called([c for _, c in steps.values()], checkout=checkout), strict=True))
    codes = {step: command.code for step, command in ended.items()}
    last = {step: command.err.strip().rpartition("\n")[2] for step, command in ended.items()}
    named = " code " in last["code"] and "optimizer.batch" in last["settings"]
    runs = load_runs(root).runs
    measured(f"exits {codes}; changes named: {named}; {len(runs)} rows for 2 runs")
    assert codes == {step: code for step, (code, _) in steps.items()}
    assert named
    assert len(runs) == 2
