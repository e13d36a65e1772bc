"""R17: a sweep that goes on after something it is made of has changed."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from experiments.faults.identifying import CHECKOUT, TINY, identified
from experiments.faults.row import Row
from miho.study import load_runs

PARTS = ("miho", "baselines", "experiments", "conf", "hydra_plugins")
CSV = "alpha,Fy\n" + "".join(f"{x / 100},{-2000 * x / 100 + 3 * (x % 3)}\n" for x in range(-30, 31))


def changes(folder: Path) -> Row:
    """Change a comment, the code, the settings, the data; then start afresh."""
    checkout, data = folder / "checkout", folder / "data.csv"
    for part in PARTS:
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(CHECKOUT / part, checkout / part, ignore=ignored)
    data.write_text(CSV, encoding="utf-8")
    root = folder / "runs"
    sweep = (
        "-m", *TINY, "seed=0,1", f"root={root}", "dataset=csv", f"dataset.path={data}",
    )  # fmt: skip
    method = checkout / "miho/optim/random_search.py"
    settings = checkout / "conf/optimizer/random.yaml"

    def call(*more: str) -> tuple[int, str]:
        code, _, err = identified(*sweep, *more, checkout=checkout)
        return code, err.strip().rpartition("\n")[2]

    found = {"first": call()[0]}
    method.write_text(method.read_text() + "\n# a comment\n", encoding="utf-8")
    found["comment"] = call()[0]
    method.write_text(method.read_text() + "\nCHANGED = True\n", encoding="utf-8")
    found["code"], code_told = call()
    found["fresh"] = call("fresh=true")[0]
    edited = re.sub(r"(?m)^batch: .*$", "batch: 7", settings.read_text(encoding="utf-8"))
    settings.write_text(edited, encoding="utf-8")
    found["settings"], settings_told = call()
    data.write_text(CSV + "0.31,-620\n", encoding="utf-8")
    found["data"], _ = call("fresh=true")
    expected = {"first": 0, "comment": 0, "code": 5, "fresh": 0, "settings": 5, "data": 0}
    named = " code " in code_told and "optimizer.batch" in settings_told
    runs = load_runs(root).runs
    return Row(
        "R17", "code, settings or data change before a sweep goes on",
        "exit 5 says what changed, fresh=true starts anew, comments count for nothing",
        f"exits {found}; changes named: {named}; {len(runs)} rows for 2 runs",
        found == expected and named and len(runs) == 2,
    )  # fmt: skip
