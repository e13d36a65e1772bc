"""What a configuration may name, and that the list is read and not imported."""

import pickle
import subprocess
import sys
from pathlib import Path

import pytest
from omegaconf import OmegaConf

import miho.methods
from experiments.app.build import ConfigError
from experiments.app.compose import composed
from experiments.app.instantiation import instantiate
from experiments.app.safety import HOMES, TargetError, allowed, find_target, nested_target
from miho.data import Dataset
from miho.models import Model
from miho.moved import MOVED, new_name, with_present_names
from miho.optim import Optimizer
from miho.vehicle.models import Pacejka

CONF = Path(__file__).parents[2] / "conf"


def test_every_target_in_conf_is_allowed() -> None:
    names = {name for kind in HOMES for name in allowed(kind)}
    for path in set(CONF.rglob("*.yaml")) - set((CONF / "hydra").rglob("*.yaml")):
        for line in path.read_text(encoding="utf-8").splitlines():
            if line.strip().startswith("_target_:"):
                assert line.split(":")[1].strip() in names, path


def test_what_is_allowed_is_found() -> None:
    assert find_target("miho.vehicle.models.Pacejka", Model) is Pacejka
    for name in allowed(Dataset):
        assert callable(find_target(name, Dataset))


@pytest.mark.parametrize(
    "path",
    [
        "miho.vehicle.models.tire.Pacejka", "miho.models.tire.Pacejka", "miho.models.tire",
        "miho.models.Model", "miho.vehicle.models.TirError", "miho.optim.MIHO", "miho.models.",
        "miho.vehicle.models.Pacejka ", "miho.models.__all__", "baselines.dehb.DEHB", "Pacejka", "",
        None, 3,
        ["miho.vehicle.models.Pacejka"], {"_target_": "miho.vehicle.models.Pacejka"}, "x" * 10_000,
    ],
)  # fmt: skip
def test_anything_else_is_refused_in_one_line(path: object) -> None:
    with pytest.raises(TargetError, match=r"that gives a Model; allowed are .*Pacejka") as caught:
        find_target(path, Model)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("name", ["cma_es.CMAESState", "dfo_ls._ScaledResiduals", "dehb.np", ""])
def test_only_methods_come_from_the_baselines(name: str) -> None:
    with pytest.raises(TargetError):
        find_target(f"baselines.{name}", Optimizer)


def test_a_light_method_is_in_one_place_and_its_settings_can_be_pickled() -> None:
    own = ("MIHO", "MIHOGN", "MIHOQN", "RandomSearch")
    light = [name for name in miho.methods.__all__ if name not in own]
    assert not {path.rpartition(".")[2] for path in allowed(Optimizer) if "baselines" in path} & {
        *light
    }
    for name in light:
        method = getattr(miho.methods, name)
        assert find_target(f"miho.methods.{name}", Optimizer) is method
        settings = method(0.1) if name == "GBO" else method()
        assert pickle.loads(pickle.dumps(settings)) == settings


@pytest.mark.parametrize(
    "former", [*MOVED, "baselines.pso.PSO", "baselines.local_search.NelderMead"]
)
def test_a_former_name_is_answered_with_the_present_one(former: str) -> None:
    present = new_name(former)
    assert present is not None
    for kind in (kind for kind in HOMES if present in allowed(kind)):
        with pytest.raises(TargetError) as caught:
            find_target(former, kind)
        assert str(caught.value) == f"'{former}' is now '{present}'"
    home, _, name = former.rpartition(".")
    with pytest.raises(ImportError, match="is now") as refused:
        exec(f"from {home} import {name}")
    assert present.rpartition(".")[0] in str(refused.value)


def test_a_stored_configuration_is_read_with_present_names() -> None:
    stored = {
        "optimizer": {"_target_": "baselines.pso.PSO", "particles": 20},
        "problem": {"name": "baselines.pso.PSO", "parts": [{"_target_": "miho.models.Pacejka"}]},
    }
    read = with_present_names(stored)
    assert read["optimizer"] == {"_target_": "miho.methods.PSO", "particles": 20}
    assert read["problem"]["name"] == "baselines.pso.PSO", "no target"
    assert read["problem"]["parts"] == [{"_target_": "miho.vehicle.models.Pacejka"}]
    former = {"_target_": "miho.optim.MIHOGN", "least": 3, "eta": 3}
    present = {"_target_": "miho.optim.MIHOGN", "min_candidates": 3, "eta": 3}
    assert with_present_names(former) == present


def test_a_former_setting_is_answered_with_the_present_one() -> None:
    with pytest.raises(ConfigError, match=r"optimizer\.least: is now optimizer\.min_candidates"):
        composed(["optimizer=miho_gn", "optimizer.least=5"])
    with pytest.raises(ConfigError, match=r"optimizer\.least: is unknown"):
        composed(["optimizer=pso_100", "optimizer.least=5"])


def test_the_list_is_read_without_importing_a_method() -> None:
    script = (
        "import sys; from experiments.app.safety import allowed; from miho.optim import Optimizer;"
        "names = allowed(Optimizer); assert 'baselines.dehb.DEHB' in names;"
        "packages = {name.split('.')[1] for name in sys.modules if name.startswith('baselines.')};"
        "assert packages == {'online', 'problems'}, packages"
    )
    subprocess.run([sys.executable, "-c", script], check=True, cwd=CONF.parent)


def test_a_target_inside_of_a_setting_is_refused() -> None:
    node = {
        "_target_": "miho.vehicle.data.sample_tir",
        "tire": "lf",
        "ranges": {"Fz": [{"_target_": "x"}]},
    }
    with pytest.raises(
        ConfigError, match=r"dataset.ranges.Fz\[0\]._target_: a target is not allowed"
    ):
        instantiate(node, "dataset", Dataset)
    assert nested_target(OmegaConf.to_container(OmegaConf.create({"a": [1, {}]})), "k") is None
