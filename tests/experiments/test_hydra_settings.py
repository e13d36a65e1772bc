"""What may be said to Hydra itself."""

import argparse

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from experiments.app.compose import CONF
from experiments.app.safety import HydraSettingError, check_arguments, check_hydra
from experiments.app.schema import register

register()


def hydra_node(*overrides: str) -> DictConfig:
    with initialize_config_dir(str(CONF), version_base="1.3"):
        node: DictConfig = compose("config", list(overrides), return_hydra_config=True).hydra
    return node


@pytest.fixture(scope="module")
def usual() -> DictConfig:
    return hydra_node()


@pytest.mark.parametrize("given", [[], ["seed=1", "root=x"], ["hydra.verbose=true"]])
def test_usual_settings_pass(usual: DictConfig, given: list[str]) -> None:
    check_hydra(hydra_node(*given), usual, given)


BAD = {
    "+hydra.callbacks.x={_target_: os.getcwd}": "hydra.callbacks: cannot be changed",
    "+hydra.job_logging.handlers={x: {class: os.system}}": "hydra.job_logging: cannot be changed",
    "hydra.run.dir=../x": "hydra.run: cannot be changed",
    "hydra.sweep.dir=/tmp": "hydra.sweep: cannot be changed",
    "hydra.output_subdir=x": "hydra.output_subdir: cannot be changed",
    "+hydra.job.env_set.PYTHONPATH=/tmp": "hydra.job.env_set: cannot be changed",
    "hydra.job.chdir=true": "hydra.job.chdir: cannot be changed",
    "hydra.launcher=x": "hydra.launcher: is not a mapping",
    "hydra.launcher._target_=os.system": "'os.system' is not a plugin of Hydra",
    "hydra.launcher._target_=hydra._internal.core_plugins.basic_launcher.log.error": "is not a",
    "hydra.sweeper._target_=hydra_plugins.mine.os.system": "hydra.sweeper: cannot be changed",
    "+hydra.launcher.x={_target_: os.getcwd}": "hydra.launcher holds a target of its own",
    "+hydra.launcher.x=[{_target_: os.getcwd}]": r"hydra.launcher.x\[0\]._target_: ",
}


@pytest.mark.parametrize("override", BAD)
def test_others_are_refused(usual: DictConfig, override: str) -> None:
    with pytest.raises(HydraSettingError, match=BAD[override]):
        check_hydra(hydra_node(override), usual, [override])


def test_what_reaches_a_shell_must_be_typed(usual: DictConfig) -> None:
    override = "+hydra.launcher.setup=[module load python]"
    node = hydra_node(override)
    check_hydra(node, usual, [override])
    with pytest.raises(HydraSettingError, match=r"hydra.launcher.setup: reaches a shell"):
        check_hydra(node, usual, ["experiment=received"])


@pytest.mark.parametrize("option", ["config_path", "config_name", "experimental_rerun"])
def test_options_that_replace_our_configuration(option: str) -> None:
    options = ("config_dir", "config_path", "config_name", "experimental_rerun")
    given = dict.fromkeys(options) | {"overrides": []}
    check_arguments(argparse.Namespace(**given))
    with pytest.raises(HydraSettingError, match=f"--{option.replace('_', '-')}: cannot be used"):
        check_arguments(argparse.Namespace(**given | {option: "x"}))
    with pytest.raises(HydraSettingError, match="searchpath: cannot be changed"):
        check_arguments(
            argparse.Namespace(**given | {"overrides": ["hydra.searchpath=[pkg://antigravity]"]})
        )
