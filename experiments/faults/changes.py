"""R17: a sweep that goes on after something it is made of has changed."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from experiments.faults.called import Call, called
from experiments.faults.identifying import CHECKOUT, TINY
from experiments.faults.row import Row
from miho.study import load_runs

PARTS = ("miho", "baselines", "experiments", "conf")
CSV = "alpha,Fy\n" + "".join(f"{x / 100},{-2000 * x / 100 + 3 * (x % 3)}\n" for x in range(-30, 31))


def changes(folder: Path) -> Row:
    """Change a comment, the code, the settings, the data; then start afresh."""
    checkout, data = folder / "checkout", folder / "data.csv"
    for part in PARTS:
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(CHECKOUT / part, checkout / part, ignore=ignored)
    method = checkout / "miho/optim/random_search.py"
    settings = checkout / "conf/optimizer/random.yaml"
    commented = method.read_text(encoding="utf-8") + "\n# a comment\n"
    edited = re.sub(r"(?m)^batch: .*$", "batch: 7", settings.read_text(encoding="utf-8"))
    root = folder / "runs"
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
    found = {step: one.code for step, one in ended.items()}
    told = {step: one.err.strip().rpartition("\n")[2] for step, one in ended.items()}
    named = " code " in told["code"] and "optimizer.batch" in told["settings"]
    runs = load_runs(root).runs
    return Row(
        "R17", "code, settings or data change before a sweep goes on",
        "exit 5 says what changed, fresh=true starts anew, comments count for nothing",
        f"exits {found}; changes named: {named}; {len(runs)} rows for 2 runs",
        found == {step: code for step, (code, _) in steps.items()} and named and len(runs) == 2,
    )  # fmt: skip
