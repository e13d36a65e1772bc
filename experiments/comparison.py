"""A finished comparison as the store holds it: its runs, what to say of them, whence they come."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.app.build import ConfigError
from miho.study import load_runs, read_run, write_text

COMPARISON = "comparison.json"


@dataclass(frozen=True)
class Comparison:
    """`runs` and `curves` as in `miho.load_runs`, `note` says how large it was."""

    runs: pd.DataFrame
    curves: pd.DataFrame
    note: str
    command: tuple[str, ...]

    @classmethod
    def read(cls, root: Path) -> Comparison:
        """The last comparison below `root`; raises ConfigError if it is not there or not whole."""
        try:
            about = json.loads((root / COMPARISON).read_text(encoding="utf-8"))
            planned, note = set(about["runs"]), str(about["note"])
            command = tuple(map(str, about["command"]))
        except (FileNotFoundError, ValueError, LookupError, TypeError):
            raise ConfigError(
                f"{root}: holds no comparison; run python -m experiments.compare root={root} first"
            ) from None
        found = load_runs(root)
        runs = found.runs[found.runs["id"].isin(planned)]
        curves = found.curves[found.curves["id"].isin(planned)]
        if len(runs) < len(planned):
            missing = len(planned) - len(runs)
            raise ConfigError(
                f"{root}: runs of the comparison are missing ({missing}); compare again"
            )
        return cls(runs, curves, note, command)

    def write_tables(
        self, tables: Mapping[str, pd.DataFrame], captions: Mapping[str, str], output: Path
    ) -> list[Path]:
        """Each table as CSV and as Markdown with its caption, which is printed as well."""
        from miho.analysis import to_markdown  # not before a comparison is over: it loads figures

        output.mkdir(parents=True, exist_ok=True)
        paths = []
        for name, table in tables.items():
            text = f"{captions[name]} Runs: {self.note}.\n\n{to_markdown(table)}"
            print(text)
            write_text(output / f"{name}.csv", table.to_csv(index=False))
            write_text(output / f"{name}.md", text)
            paths += [output / f"{name}.csv", output / f"{name}.md"]
        return paths

    def write_provenance(self, output: Path) -> Path:
        """What regenerates it, and what it ran on."""
        stored = [read_run(Path(folder)) for folder in self.runs["folder"]]
        environment = dict(stored[0].environment)
        environment.pop("load")
        environment.pop("timing", None)
        loads = [run.environment["load"] for run in stored]
        about: dict[str, Any] = {
            "command": " ".join(self.command),
            "seeds": f"{self.runs['seed'].min()} to {self.runs['seed'].max()}",
            "code": sorted({run.result["code"] for run in stored}),
            "data": sorted({run.result["data"] for run in stored}),
            "environment": environment,
            "drawn with python": platform.python_version(),
            "largest load average during the runs": max(
                (load[0] for load in loads if load), default=None
            ),
        }
        path = output / "provenance.json"
        write_text(path, json.dumps(about, indent=1) + "\n")
        return path
