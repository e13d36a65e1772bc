"""R14: hostile targets from every side, and whether any is imported or run."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig, OmegaConf

from experiments.app.build import ConfigError, build, rebuild
from experiments.app.compose import composed
from miho.study import StoredRun
from tests.faults.commands import CHECKOUT
from tests.faults.conftest import Figures

CANARY = "canary_of_targets"
TARGETS = [
    "os.system", "os.popen", "os.execv", "os.remove", "posix.system", "subprocess.Popen",
    "subprocess.check_output", "subprocess.run", "shutil.rmtree", "builtins.eval",
    "builtins.exec", "builtins.__import__", "builtins.open", "importlib.import_module",
    "runpy.run_path", "runpy.run_module", "pickle.load", "pickle.loads", "marshal.loads",
    "code.interact", "ctypes.CDLL", "socket.create_connection", "urllib.request.urlopen",
    "webbrowser.open", "numpy.load", "pandas.read_pickle", "scipy.io.loadmat",
    "hydra.utils.instantiate", ".".join(("hydra", "_internal", "utils", "_get_cls_name")),
    "omegaconf.OmegaConf.save", CANARY, f"{CANARY}.Pacejka", f"{CANARY}.inner.Pacejka",
    "miho.study.files.os.system", "miho.models.function_model.Path.unlink",
    "miho.models.function_model.ast.literal_eval",
    "miho.vehicle.models.Pacejka.__init__.__globals__",
    "baselines.dehb.os.system", "baselines.canary_of_targets.Pacejka",
    "miho.testing.optimizers.pickle.loads", "baselines...os.system", "miho.models.\uff30acejka",
    "__main__.Pacejka", "",
]  # fmt: skip
"""What does harm by a call or by being imported, some of it behind names of ours."""

WATCHED = (
    "os.system", "os.exec", "os.posix_spawn", "os.fork", "os.remove", "os.rmdir", "shutil.rmtree",
    "subprocess.Popen", "socket.connect", "urllib.Request", "pickle.find_class", "ctypes.dlopen",
    "code.__new__",
)  # fmt: skip
"""Audit events (PEP 578) that none of these configurations may cause."""

Attack = Callable[[str, Path], object]


@pytest.mark.slow
@pytest.mark.fault(
    row="R14",
    fault=f"{len(TARGETS)} hostile targets from 4 sides: a file, an override, a saved run, an "
    "interpolation",
    promise="0 executed, 0 modules imported, each refused in a line naming the key and what is "
    "allowed",
    quick=True,
)
def test_targets(tmp_path: Path, measured: Figures) -> None:
    """Each target in a file, an override, a saved run and an interpolation."""
    canary = tmp_path / "imported"
    (tmp_path / f"{CANARY}.py").write_text(
        f"from pathlib import Path\nPath({str(canary)!r}).touch()\n"
        f"from miho.models import Pacejka\n",
        encoding="utf-8",
    )
    command = [sys.executable, "-m", "tests.faults.test_targets", str(tmp_path)]
    process = subprocess.run(
        command, capture_output=True, text=True, check=True, cwd=CHECKOUT, timeout=120
    )
    answers = json.loads(process.stdout)
    imported = [*answers["modules"], *(["the canary"] if canary.exists() else [])]
    measured(
        f"{len(answers['events'])} executed, {len(imported)} imported, "
        f"{answers['refused']} of {answers['attacks']} refused in such a line"
    )
    assert answers["refused"] == answers["attacks"] == len(TARGETS) * len(ATTACKS)
    assert not imported
    assert not answers["events"]


def _in_a_file(target: str, folder: Path) -> object:
    """A file that is chosen as Hydra chooses it, with `model=received`."""
    OmegaConf.save({"_target_": target}, folder / "received.yaml")
    return build(_base(model=OmegaConf.load(folder / "received.yaml")))


def _in_an_override(target: str, _: Path) -> object:
    override = OverridesParser.create().parse_override(f'model._target_="{target}"')
    return build(_base(model={override.key_or_group.rpartition(".")[2]: override.value()}))


def _in_a_saved_run(target: str, folder: Path) -> object:
    saved = _saved_config()
    return rebuild(StoredRun(folder, {**saved, "model": {"_target_": target}}, {}, {}, {}))


def _in_an_interpolation(target: str, _: Path) -> object:
    return build(_base(model={"_target_": "${problem.name}"}, problem={"name": target}))


ATTACKS: dict[str, Attack] = {
    "a file": _in_a_file,
    "an override": _in_an_override,
    "a saved run": _in_a_saved_run,
    "an interpolation": _in_an_interpolation,
}


@cache
def _composed() -> DictConfig:
    return composed(["dataset.n=10", "optimizer=random"])


@cache
def _saved_config() -> Mapping[str, Any]:
    return build(_composed()).identity.config


def _base(**changes: Any) -> DictConfig:
    """The usual configuration with other nodes, as an override of each gives it."""
    cfg = _composed().copy()
    for key, node in changes.items():
        OmegaConf.update(cfg, key, node, merge=True)
    return cfg


def _attack(folder: Path) -> dict[str, Any]:
    """What the attacks did to this process."""
    sys.path.insert(0, str(folder))
    refused = attacks = 0
    events: list[str] = []
    for attack in ATTACKS.values():  # what refusals themselves import is imported now
        _refused(attack, "unheard.of", folder)
    before = set(sys.modules)
    with _watching(events):
        for attack in ATTACKS.values():
            for target in TARGETS:
                attacks += 1
                refused += _refused(attack, target, folder)
    modules = sorted(set(sys.modules) - before)
    return {"attacks": attacks, "refused": refused, "modules": modules, "events": events}


def _refused(attack: Attack, target: str, folder: Path) -> bool:
    try:
        attack(target, folder)
    except ConfigError as error:
        line = str(error)
        return line.isprintable() and line.startswith("model._target_: ") and "allowed are" in line
    return False


@contextmanager
def _watching(events: list[str]) -> Iterator[None]:
    on = True

    def hook(event: str, _: tuple[Any, ...]) -> None:
        if on and event in WATCHED:
            events.append(event)

    sys.addaudithook(hook)
    try:
        yield
    finally:
        on = False


if __name__ == "__main__":
    json.dump(_attack(Path(sys.argv[1])), sys.stdout)
