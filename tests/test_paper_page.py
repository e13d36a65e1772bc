"""The page on the paper: its names, commands, options, counts and verdicts are true."""

from __future__ import annotations

import ast
import csv
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple, get_type_hints

import pytest
import yaml

from experiments.app.schema import Config

ROOT = Path(__file__).parent.parent
CONF = ROOT / "conf"
TEXT = (ROOT / "docs/paper.md").read_text(encoding="utf-8")
VERDICTS = ("implemented", "reproduced", "not reproduced", "weak", "missing")
CLAIMS = {
    "13 times faster": "MIHO is faster than GBO and PSO to 1.0 kN, in evaluations",
    "494 times faster": "MIHO is faster than GBO and PSO to 0.5 kN, in evaluations",
    "terminal error": "terminal error of MIHO",
    "24 % below PSO-500": "MIHO ends below pso_500 by",
    "76 % below GBO-large": "MIHO ends below gbo_large by",
    "PSO-100 stays": "pso_100 stops at",
    "GBO-small is stable": "gbo_small hardly moves: its error falls by",
    "GBO-large is unstable": "gbo_large is unstable: evaluations without improvement",
    "PSO-500 needs more": "pso_500 needs more evaluations than pso_100 to 1.0 kN",
}
"""Rows of the page about the claims of docs/results/paper_fig6/claims.csv."""


class Row(NamedTuple):
    item: str
    names: str
    command: str
    deviation: str
    verdict: str


def rows() -> list[Row]:
    lines = re.findall(r"^\| (?!item \||---)(.*) \|$", TEXT, re.MULTILINE)
    return [Row(*line.split(" | ")) for line in lines]


def spans(text: str) -> list[str]:
    return re.findall(r"`([^`]+)`", text)


@cache
def defined(path: Path) -> set[str]:
    """Names that a module defines, those of classes with the class before them."""
    names = set()

    def collect(body: list[ast.stmt], prefix: str) -> None:
        for node in body:
            if isinstance(node, ast.ClassDef | ast.FunctionDef):
                names.add(prefix + node.name)
            if isinstance(node, ast.ClassDef):
                collect(node.body, f"{node.name}.")
            targets = node.targets if isinstance(node, ast.Assign) else []
            names.update(target.id for target in targets if isinstance(target, ast.Name))
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                names.add(prefix + node.target.id)

    collect(ast.parse(path.read_text(encoding="utf-8")).body, "")
    return names


def assert_exists(reference: str) -> None:
    """A path from the root, perhaps with the name of something in it behind `::`."""
    path, _, name = reference.partition("::")
    assert (ROOT / path).is_file(), path
    assert not name or name in defined(ROOT / path), reference


def options(group: str) -> Iterator[str]:
    """The texts of all files of a group."""
    for path in (CONF / group).glob("*.yaml"):
        yield path.read_text(encoding="utf-8")


def is_option(text: str) -> bool:
    """Whether `key=values`, or a key with dots, is something that a configuration has."""
    key, _, values = text.partition("=")
    first, *rest = key.split(".")
    if not rest and (CONF / first).is_dir():
        return all((CONF / first / f"{value}.yaml").is_file() for value in values.split(","))
    node: type | None = Config
    for part in (first, *rest):
        if node is None:  # a mapping: its keys stand in the files of the group of that name
            group = next(name for name in reversed(key.split(".")[:-1]) if (CONF / name).is_dir())
            return any(re.search(rf"^\s*{part}:", option, re.M) for option in options(group))
        if part not in {field.name for field in fields(node)}:
            return False
        kind = get_type_hints(node)[part]
        node = kind if is_dataclass(kind) and isinstance(kind, type) else None
    return True


def assert_option(text: str) -> None:
    assert is_option(text), text


def assert_command(command: str) -> None:
    program, *words = command.split()
    if program == "pytest":
        for word in words:
            if word not in ("-m", "slow"):
                assert_exists(word)
        return
    if program == "make":
        makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
        assert re.search(rf"^{words[0]}:", makefile, re.MULTILINE), command
        return
    module = ROOT.joinpath(*program.split(".")).with_suffix(".py")
    assert module.is_file(), command
    for word in (word.strip("'") for word in words):
        if "=" in word:
            assert_option(word)
        elif word != "-m":
            assert word in module.read_text(encoding="utf-8"), command


def test_the_head_counts_the_rows() -> None:
    counts = Counter(row.verdict.partition(":")[0] for row in rows())
    assert set(counts) | {"missing"} == set(VERDICTS)
    parts = ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS)
    assert TEXT.splitlines()[2] == f"{len(rows())} items: {parts}."


def test_a_verdict_that_is_not_full_says_why() -> None:
    for row in rows():
        word, _, reason = row.verdict.partition(": ")
        assert word != "weak" or reason, row.item


def test_files_and_names_exist() -> None:
    for row in rows():
        found = spans(row.names)
        assert found or row.verdict == "missing", row.item
        for reference in found:
            assert_exists(reference)


def test_commands_and_options_exist() -> None:
    for row in rows():
        commands = spans(row.command)
        assert commands or row.verdict == "missing", row.item
        for command in commands:
            assert_command(command)
        for span in spans(row.deviation):
            module, *words = span.split()
            if module.startswith("experiments."):
                assert_command(span)
            elif not words and re.fullmatch(r"[a-z_.]+=[\w.]+|[a-z_]+(\.[a-z_]+)+", span):
                assert_option(span)


@pytest.mark.parametrize("text", ["optimizer.rounds_up=1", "dataset=tire_xx", "drive.unknown=1"])
def test_an_option_that_nobody_has_is_seen(text: str) -> None:
    assert not is_option(text)


def test_claims_have_the_measured_verdicts() -> None:
    with (ROOT / "docs/results/paper_fig6/claims.csv").open(encoding="utf-8") as file:
        measured = {row["claim"]: row["verdict"] for row in csv.DictReader(file)}
    for words, claim in CLAIMS.items():
        (row,) = (row for row in rows() if words in row.item)
        assert row.verdict.partition(":")[0] == measured[claim], row.item


def test_the_papers_settings_are_the_configured_ones() -> None:
    def conf(name: str) -> dict[str, object]:
        content = yaml.safe_load((CONF / name).read_text(encoding="utf-8"))
        assert isinstance(content, dict)
        return content

    def optimizer(name: str, *keys: str) -> list[object]:
        return [conf(f"optimizer/{name}.yaml")[key] for key in keys]

    assert optimizer("miho", "R", "eta") == [10_000, 5]
    assert optimizer("gbo_small", "learning_rate") == [5e-12]
    assert optimizer("gbo_large", "learning_rate") == [1e-10]
    assert optimizer("pso_100", "particles", "c1", "c2") == [100, 2, 2]
    assert optimizer("pso_500", "particles", "c1", "c2") == [500, 2, 2]
    for tire in ("lf", "rf", "lr", "rr"):
        assert conf(f"dataset/tire_{tire}.yaml")["dataset"]["n"] == 3000  # type: ignore[index]
    for percent in (5, 15, 20):
        settings = conf(f"dataset/torque_{percent:02}.yaml")["dataset"]
        assert settings["throttle"] == percent / 100  # type: ignore[index]
    avoidance = conf("experiment/ims_obstacle.yaml")["drive"]
    laps = conf("experiment/lvms_laps.yaml")["drive"]
    assert isinstance(avoidance, dict) and isinstance(laps, dict)
    assert avoidance["performance_factor"] == 0.7
    assert 3.6 * avoidance["speed"] == pytest.approx(100, abs=0.01)
    assert len(laps["top_speeds"]) == 9
    assert 3.6 * max(laps["top_speeds"]) == pytest.approx(217.4, abs=0.1)
