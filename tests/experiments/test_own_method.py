"""A method of the user: a class in a file that `optimizer.path` names."""

import copy
import pickle
import subprocess
import sys
from pathlib import Path

import pytest
from omegaconf import DictConfig, open_dict

from experiments.app.build import ConfigError, build, build_optimizer
from experiments.app.compose import composed
from experiments.app.execution import execution_of
from experiments.app.plan import requests
from experiments.app.run_text import result_text
from experiments.app.runs import run
from experiments.app.schema import SweepConfig
from miho.study import Status

FILE = """
from __future__ import annotations

from dataclasses import dataclass

import miho
from miho import MIHOGN


@dataclass(frozen=True)
class Walk(miho.Optimizer):
    points: int = 4

    def run(self, oracle, rng):
        space = oracle.space
        while True:
            oracle(space.decode(space.sample(self.points, rng)))


class Other(miho.Optimizer):
    def run(self, oracle, rng):
        oracle.space.sample(rng, 4)


class Bare(miho.Optimizer):
    pass


class Idle(miho.Optimizer):
    def run(self, oracle, rng):
        pass


class Broken(Walk):
    def __init__(self):
        1 / 0
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "walk.py"
    path.write_text(FILE, encoding="utf-8")
    return path


def config(file: Path, target: str | None = "Walk", **settings: object) -> DictConfig:
    cfg = composed(["dataset.n=40", "budget.evaluations=20", f"root={file.parent / 'runs'}"])
    with open_dict(cfg):
        cfg.optimizer = {"_target_": target, "path": str(file)} | settings
        cfg.method = None
    return cfg


def test_a_method_that_evaluates_nothing_is_named_as_such(file: Path) -> None:
    experiment = build(config(file, "Idle"))
    stored = execution_of(experiment).run
    assert stored is not None
    assert "the method ended without an evaluation" in result_text(experiment, stored)


def test_it_runs_and_is_named_by_its_class(file: Path) -> None:
    cfg = config(file, points=5)
    assert build_optimizer(cfg).points == 5  # type: ignore[attr-defined]
    plan = requests(cfg, "", range(2))
    assert all(request.own_code and request.identity.optimizer == "walk" for request in plan)
    (first, second) = run(plan, SweepConfig(workers=2)).states
    assert first.status is second.status is Status.RAN
    assert first.error != second.error


def test_it_pickles_in_this_process_and_in_another_one(file: Path) -> None:
    first, second = (build_optimizer(config(file, points=n)) for n in (5, 6))
    for method in (first, second):
        assert pickle.loads(pickle.dumps(method)) == method
        assert copy.deepcopy(method) == method
    stored = pickle.dumps([second, second])
    program = f"import pickle; a, b = pickle.loads({stored!r}); print(a, type(a) is type(b))"
    process = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert process.stdout == "Walk(points=6) True\n", process.stderr
    file.write_text("import miho\n", encoding="utf-8")
    process = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert "walk.py: has no class Walk any more; restore it" in process.stderr


def test_an_object_may_reduce_itself_to_a_partial_function(file: Path) -> None:
    with file.open("a", encoding="utf-8") as end:
        end.write(
            "\n\nclass Partial(Walk):\n    def __reduce__(self):\n        import functools\n\n"
            "        return functools.partial(slice, 1), (2,)\n"
        )
    assert pickle.loads(pickle.dumps(build_optimizer(config(file, "Partial")))) == slice(1, 2)


def test_an_edit_of_the_file_or_of_a_setting_makes_another_run(file: Path) -> None:
    identities = [build(config(file)).identity, build(config(file, points=5)).identity]
    file.write_text(FILE.replace("self.points, rng", "self.points - 1, rng"), encoding="utf-8")
    identities.append(build(config(file)).identity)
    assert len({identity.id for identity in identities}) == 3
    assert identities[2].code != identities[0].code


@pytest.mark.parametrize(
    ("target", "settings", "message"),
    [
        (
            "Wlak",
            {},
            r"_target_: .*walk.py has no class Wlak .*; it has Walk, Other, Idle, Broken$",
        ),
        ("MIHOGN", {}, "has no class MIHOGN"),
        ("Path", {}, "has no class Path"),
        ("Broken", {}, r"optimizer: .*walk.py:\d+: raises ZeroDivisionError: division by zero$"),
        (
            None,
            {},
            r"optimizer._target_: is missing; name a class of .*: Walk, Other, Idle, Broken$",
        ),
        ("Bare", {}, r"_target_: Bare in .*walk.py lacks run"),
        ("os.system", {}, "has no class os.system"),
        ("Walk", {"point": 3}, r"optimizer.point: is unknown; did you mean points\?"),
        ("Walk", {"points": "many"}, "optimizer.points: is 'many'"),
        ("Walk", {"path": 3}, "optimizer.path: is 3; expected a file"),
    ],
)
def test_a_mistake_is_one_line(
    file: Path, target: str | None, settings: dict[str, object], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        build_optimizer(config(file, target, **settings))


def test_a_file_that_cannot_be_run_names_its_line(file: Path) -> None:
    file.write_text("import miho\n1 / 0\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"walk.py:2: raises ZeroDivisionError"):
        build_optimizer(config(file))
    with pytest.raises(FileNotFoundError):
        build_optimizer(config(file.with_name("none.py")))
    (lost,) = run(requests(config(file), "", [0], lose=True), SweepConfig()).states
    assert lost.status is Status.LOST


def test_a_run_that_raises_fails_alone(file: Path) -> None:
    (failed,) = run(requests(config(file, "Other"), "", [0]), SweepConfig()).states
    assert failed.status is Status.FAILED
    assert "(walk.py:22)" in failed.line, "the line of the user, not of the library that it calls"


def test_without_a_path_the_message_names_it() -> None:
    cfg = composed([])
    with open_dict(cfg):
        cfg.optimizer = {"_target_": "mine.Walk"}
    with pytest.raises(ConfigError, match=r"'mine.Walk' is not .* needs path: FILE.py too"):
        build_optimizer(cfg)
