"""The commands do what Hydra's manual says, and sweeps end in the store by any launcher."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import optuna
import pytest
import yaml
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.utils import instantiate

from experiments import identify
from experiments.app import launch
from experiments.app.compose import CONF
from experiments.app.explain import ConfigError, check_choices, replace_spaces
from experiments.app.options import options_of
from miho import load_runs
from miho.data import Dataset
from miho.models import Model
from miho.optim import Optimizer
from miho.study import StoredRun
from miho.study.manifest import sweep_commands
from miho.study.store import read_run

ROOT = Path(__file__).parent.parent
TINY = ("optimizer=random", "optimizer.batch=5", "budget.evaluations=20", "dataset.n=40")


@dataclass(frozen=True)
class Ended:
    """A command that has ended, and the folder of its results."""

    code: int
    out: str
    err: str
    root: Path

    @property
    def ids(self) -> list[str]:
        return sorted(load_runs(self.root).runs["id"])

    def hydra(self, kind: str, name: str) -> list[Path]:
        """Files of Hydra's in the folders of the job."""
        return sorted((self.root / kind).glob(f"*/*/**/{name}"))


Typed = Callable[..., Ended]


@pytest.fixture
def typed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Typed:
    """Run experiments.identify in this process on a tiny problem."""

    def run(*arguments: str, tiny: bool = True) -> Ended:
        small = TINY if tiny else ("budget.evaluations=20", "dataset.n=40")
        root = tmp_path / "runs"
        GlobalHydra.instance().clear()
        monkeypatch.setattr(sys, "argv", ["identify", *small, f"root={root}", *arguments])
        with pytest.raises(SystemExit) as end:
            identify.main()
        return Ended(int(end.value.code or 0), *capsys.readouterr(), root)

    return run


def own(tmp_path: Path, name: str, text: str) -> str:
    """An experiment of the user's, as --config-dir names it."""
    path = tmp_path / "own" / f"{name}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return f"--config-dir={tmp_path / 'own'}"


# What a user types, and what becomes of it: exit code and a pattern of what is printed.
HABITS: dict[str, tuple[list[str], int, str]] = {
    "choice()": (["-m", "seed=choice(3,5)"], 0, r"\[2/2\].*seed 5(.|\n)*2 runs: 2 ran"),
    "range()": (["-m", "seed=range(2)"], 0, "2 runs: 2 ran"),
    "the multirun flag after overrides": (["seed=1,2", "-m"], 0, "2 runs: 2 ran"),
    "the long flag": (["--multirun", "seed=1,2"], 0, "2 runs: 2 ran"),
    "hydra.mode": (["hydra.mode=MULTIRUN", "seed=1,2"], 0, "2 runs: 2 ran"),
    "one job": (["-m"], 0, "1 run: 1 ran"),
    "sweeper.params": (["-m", "+hydra.sweeper.params.seed='1,2,3'"], 0, "3 runs: 3 ran"),
    "params in braces": (["-m", "hydra.sweeper.params={seed: 'range(2)'}"], 0, "2 runs: 2 ran"),
    "max_batch_size": (["-m", "seed=range(3)", "hydra.sweeper.max_batch_size=2"], 0, "3 runs: 3 r"),
    "a dry run": (["-m", "seed=1,2", "sweep.dry_run=true"], 0, "2 runs: 2 to do"),
    "several values without -m": (["seed=1,2"], 2, r"seed=1,2.*--multirun"),
    "no values": (["-m", "seed=range(0)"], 2, "has no values"),
    "a glob in a folder": (["-m", "optimizer=glob(r500/*)"], 2, "no options in folders of a group"),
    "an unknown experiment": (["+experiment="], 2, r"\S"),
    "an experiment twice": (["+experiment=compare"], 2, "write experiment=compare"),
    "a list of bounds": (["space.B=[0,5]"], 2, r"space.B.low=0 space.B.high=1"),
    "a setting": (["-m", "dataset.n=40,50"], 0, r"n=40 +\w+ +1 (.|\n)*n=50 +\w+ +1 "),
    "a root of a job": (["-m", "root=x/${hydra:job.num}"], 2, "root: is .*; leave out the job"),
    "chdir, pool": (["-m", "hydra.job.chdir=true"], 2, "hydra.job.chdir=true: .*=basic, or"),
    "workers of a sweep": (["-m", "sweep.workers=1,2"], 2, "sweep: holds for the whole sweep"),
    "a sweep without -m": (["sweep.workers=2"], 2, "sweep.workers=2: is for a sweep, -m"),
    "+sweep without -m": (["++sweep.workers=2"], 2, r"\+sweep.workers=2: is for a sweep, -m"),
    "two modes": (["-m", "--cfg", "job"], 2, "Only one of --run, --multirun, --cfg"),
    "an empty batch": (["-m", "hydra.sweeper.max_batch_size=0"], 2, "Hydra requires: .* > 0"),
    "--cfg job": (["--cfg", "job"], 0, r"seed: 0\nworkers"),
    "--cfg hydra": (["--cfg", "hydra"], 0, r"_target_: hydra_plugins.miho_pool.PoolLauncher"),
    "--cfg all": (["--cfg", "all"], 0, r"hydra:\n  run:"),
    "--cfg job --resolve": (["--cfg", "job", "--resolve"], 0, "method: null"),
    "--package": (["--cfg", "job", "--package", "budget"], 0, r"evaluations: 20"),
    "--info config": (["--info", "config"], 0, ""),
    "--info last": (["--info"], 0, ""),
    "--info defaults": (["--info", "defaults"], 0, ""),
    "--info plugins": (["--info", "plugins"], 0, ""),
    "--version": (["--version"], 0, r"[Hh]ydra 1\."),
    "--config-name": (["--config-name=compare", "--cfg", "job"], 0, "seconds: 4.0"),
    "-sc install=bash": (["-sc", "install=bash"], 0, "hydra_bash_completion|COMP"),
    "sweep.subdir": (["-m", "hydra.sweep.subdir=${hydra.job.num}_a"], 0, "1 run: 1 ran"),
    "output_subdir": (["-m", "hydra.output_subdir=record"], 0, "1 run: 1 ran"),
    "a verbose logger": (["-m", "hydra.verbose=true"], 0, "1 run: 1 ran"),
    "job_logging": (["-m", "hydra/job_logging=none"], 0, "1 run: 1 ran"),
    "an environment variable": (["-m", "dataset.tire=${oc.env:A_TIRE}"], 0, "1 run: 1 ran"),
    "a missing extra": (["-m", "hydra/launcher=nothing"], 2, "allowed are"),
    "a deleted group": (["~loss"], 2, "loss"),
    "a key that is added": (["-m", "++budget.seconds=5"], 0, "1 run: 1 ran"),
}  # fmt: skip
QUICK = (
    "several values without -m", "--cfg job", "sweep.subdir", "a root of a job", "chdir, pool",
    "workers of a sweep", "a sweep without -m", "+sweep without -m", "two modes", "an empty batch",
)  # fmt: skip


@pytest.mark.parametrize(
    "habit", [pytest.param(h, marks=[] if h in QUICK else [pytest.mark.slow]) for h in HABITS]
)
def test_what_hydra_users_type(typed: Typed, monkeypatch: pytest.MonkeyPatch, habit: str) -> None:
    monkeypatch.setenv("A_TIRE", "rf")
    arguments, code, pattern = HABITS[habit]
    ended = typed(*arguments)
    assert ended.code == code, ended.out + ended.err
    assert re.search(pattern, ended.err if code else ended.out), ended.out + ended.err
    assert code == 0 or ended.err.count("\n") == 1


@pytest.mark.slow
def test_a_glob_of_methods_is_swept_over(typed: Typed) -> None:
    ended = typed("-m", "optimizer=glob(pso*)", "sweep.dry_run=true", tiny=False)
    assert ended.code == 0, ended.err
    assert "3 runs: 3 to do" in ended.out


def test_a_single_run_leaves_hydras_record(typed: Typed) -> None:
    ended = typed("seed=4")
    assert ended.code == 0, ended.err
    (overrides,) = ended.hydra("outputs", "overrides.yaml")
    assert "seed=4" in yaml.safe_load(overrides.read_text())
    assert yaml.safe_load(overrides.with_name("config.yaml").read_text())["seed"] == 4
    assert "hydra" in yaml.safe_load(overrides.with_name("hydra.yaml").read_text())


def test_seed_and_workers_may_be_variables(typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TASK", "2")
    ended = typed("-m", "seed=${oc.env:TASK}", "sweep.workers=${oc.env:TASK}")
    assert ended.code == 0, ended.err
    assert load_runs(ended.root).runs["seed"].tolist() == [2]


@pytest.mark.parametrize("how", [(), ("workers=2",), ("-m", "hydra/launcher=basic")], ids=str)
def test_a_model_works_in_the_folder_of_its_job_if_hydra_changes_it(
    typed: Typed, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, how: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(
        'def curve(alpha: "rad", *, B: "1/rad", C: "-", D: "N", Sx: "rad", Sy: "N") -> "N":\n'
        "    open('seen.txt', 'w').close()\n"
        "    return D * C * B * (alpha + Sx) + Sy\n"
    )
    paths = ("model=function", "model.path=mine.py", "root=here", "hydra.sweep.subdir=0")
    ended = typed(*paths, "hydra.job.chdir=true", *how)
    assert ended.code == 0, ended.err
    assert Path.cwd() == tmp_path
    assert len(list(Path("here").glob("*/*/*/**/seen.txt"))) == 1
    assert "done before" in typed(*paths, *how).out
    assert len(load_runs("here").runs) == 1


def test_values_of_hydra_are_those_of_the_job(typed: Typed) -> None:
    for name in ("", "_${hydra:job.num}"):
        method = "method=${hydra:runtime.choices.optimizer}" + name
        ended = typed("-m", "optimizer=random,pso_100", method, tiny=False)
        assert ended.code == 0, ended.err
    names = ["pso_100", "pso_100_1", "random", "random_0"]
    assert sorted(load_runs(ended.root).runs["optimizer"]) == names


def test_each_job_of_a_sweep_leaves_hydras_record(typed: Typed, tmp_path: Path) -> None:
    place = tmp_path / "elsewhere"
    subdir = "hydra.sweep.subdir=${hydra.job.override_dirname}"
    naming = "hydra.job.config.override_dirname.exclude_keys=[root,dataset.n,budget.evaluations]"
    ended = typed("-m", "seed=1,2", f"hydra.sweep.dir={place}", subdir, naming)
    assert ended.code == 0, ended.err
    assert (place / "multirun.yaml").is_file()
    for seed in (1, 2):
        folder = place / f"optimizer.batch=5,optimizer=random,seed={seed}" / ".hydra"
        assert yaml.safe_load((folder / "config.yaml").read_text())["seed"] == seed
        assert f"seed={seed}" in yaml.safe_load((folder / "overrides.yaml").read_text())
        hydra = yaml.safe_load((folder / "hydra.yaml").read_text())["hydra"]
        assert hydra["job"]["num"] == seed - 1
        assert hydra["runtime"]["output_dir"] == str(folder.parent)


def test_the_record_of_a_sweep_in_its_root_has_hydras_words(typed: Typed, tmp_path: Path) -> None:
    params, place = "hydra.sweeper.params={seed: 'range(2)'}", f"hydra.searchpath=[{tmp_path}]"
    assert typed("-m", params, place, f"hydra.sweep.dir={tmp_path}", "sweep.workers=1").code == 0
    (words,) = sweep_commands(tmp_path / "runs")
    assert words[4:] == [*TINY, f"root={tmp_path / 'runs'}", f"++{params}", place]


def test_the_record_of_a_sweep_in_its_root_has_its_own_configuration(
    typed: Typed, tmp_path: Path
) -> None:
    folder = own(tmp_path, "study", "defaults: [config, _self_]\n")
    assert typed(folder, "--config-name=study", "-m").code == 0
    assert typed("--config-name=compare", "-m", "budget.seconds=9").code == 0
    study, compare = sweep_commands(tmp_path / "runs")
    assert study[4:6] == [folder, "--config-name=study"]
    assert compare[4] == "--config-name=compare"


@pytest.mark.slow
def test_the_same_sweep_again_runs_nothing_and_a_larger_one_what_is_missing(typed: Typed) -> None:
    assert "2 runs: 2 ran" in typed("-m", "seed=1,2").out
    assert "3 runs: 1 ran, 2 done before" in typed("-m", "seed=3,2,1").out
    assert typed("-m", "seed=3,2,1").out.count("(done before)") == 3
    assert len(load_runs(typed("-m", "seed=1,1").root).runs) == 3


@pytest.mark.slow
def test_jobs_are_done_in_the_order_of_the_sweeper(typed: Typed) -> None:
    """The first key changes slowest: repetition by repetition, methods meet the same load."""
    ended = typed("seed=1,2", "-m", "optimizer=random,pso_100", tiny=False)
    lines = [line for line in ended.out.splitlines() if line.startswith("[")]
    assert [re.search(r"seed (\d)", line).group(1) for line in lines] == ["1", "1", "2", "2"]


def test_an_experiment_sweeps_by_itself(typed: Typed, tmp_path: Path) -> None:
    text = "# @package _global_\nhydra: {mode: MULTIRUN, sweeper: {params: {seed: '7,8'}}}\n"
    folder = own(tmp_path, "experiment/mine", text)
    ended = typed(folder, "experiment=mine")
    assert ended.code == 0, ended.err
    assert sorted(load_runs(ended.root).runs["seed"]) == [7, 8]


@pytest.mark.slow
def test_what_is_typed_replaces_the_sweep_of_an_experiment(typed: Typed) -> None:
    ended = typed("experiment=paper_fig6", "seed=0", "sweep.dry_run=true")
    assert ended.code == 0, ended.err
    assert "1 run: 1 to do" in ended.out, "optimizer=random and seed=0 are typed"
    whole = typed("-m", "experiment=paper_fig6", "sweep.dry_run=true", tiny=False)
    assert "180 runs: 180 to do" in whole.out, whole.err


def test_a_bad_value_in_a_sweep_is_one_line_before_anything_runs(typed: Typed) -> None:
    ended = typed("-m", "optimizer.batch=5,0")
    assert ended.code == 2
    assert ended.err.startswith("error: ")
    assert ended.err.count("\n") == 1
    assert load_runs(ended.root).runs.empty


CALLBACK = """
from hydra.experimental.callback import Callback


class Record(Callback):
    def __init__(self, path):
        self.path = path

    def on_job_end(self, config, job_return, **kwargs):
        with open(self.path, "a") as file:
            file.write(f"{config.hydra.job.num} {config.seed} {job_return.return_value > 0}\\n")

    def on_multirun_end(self, config, **kwargs):
        with open(self.path, "a") as file:
            file.write("end\\n")
"""


def test_callbacks_are_called(
    typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a class of the user's, in a configuration of the user's."""
    (tmp_path / "my_callbacks.py").write_text(CALLBACK)
    monkeypatch.syspath_prepend(tmp_path)
    node = f"{{_target_: my_callbacks.Record, path: {tmp_path / 'record'}}}"
    folder = own(
        tmp_path, "experiment/mine", f"# @package _global_\nhydra: {{callbacks: {{x: {node}}}}}\n"
    )
    ended = typed(folder, "experiment=mine", "-m", "seed=3,4")
    assert ended.code == 0, ended.err
    assert (tmp_path / "record").read_text() == "0 3 True\n1 4 True\nend\n"


def test_settings_that_follow_the_seed_differ_in_a_sweep(typed: Typed) -> None:
    ended = typed("-m", "seed=3,21", "dataset.seed=${seed}", "method=m${seed}")
    assert ended.code == 0, ended.err
    runs = load_runs(ended.root).runs
    stored = [read_run(Path(folder)) for folder in runs["folder"]]
    assert [run.config["dataset"]["seed"] for run in stored] == list(runs["seed"])
    assert list(runs["optimizer"]) == [f"m{seed}" for seed in runs["seed"]]


def test_a_setting_of_swept_options_is_not_for_the_default_option(typed: Typed) -> None:
    sweep = ("-m", "optimizer=pso_100,pso_500", "optimizer.particles=5")
    ended = typed(*sweep, tiny=False)
    assert ended.code == 0, ended.err
    assert "2 runs: 2 ran" in ended.out
    (record,) = (ended.root / ".sweeps").iterdir()
    assert "optimizer.particles=5" in json.loads(record.read_text())["overrides"]


def test_a_list_of_experiments_is_merged() -> None:
    check_choices(["experiment=[compare,torque_gap]"])
    with pytest.raises(ConfigError, match="is a list; choose one option"):
        check_choices(["dataset=[tire_lf,tire_rf]"])


def test_null_and_quoted_texts_hold_in_a_sweep_over_options() -> None:
    fixed = ["problem.sigma=null", 'dataset.path="Schräglauf, 1.csv"', "model.path='5'"]
    assert replace_spaces(["optimizer=pso_100,pso_500", *fixed])[1:] == fixed


def test_a_sweep_over_roots_stores_a_run_in_each(typed: Typed, tmp_path: Path) -> None:
    roots = [tmp_path / "a", tmp_path / "b"]
    ended = typed("-m", f"root={roots[0]},{roots[1]}")
    assert ended.code == 0, ended.err
    assert [len(load_runs(root).runs) for root in roots] == [1, 1]


def test_the_pool_sets_variables_of_the_environment(typed: Typed) -> None:
    sweep = ["-m", "+hydra.job.env_set.A_TIRE=rr", "dataset.tire=${oc.env:A_TIRE}"]
    assert "pacejka-tire_rr" in typed(*sweep).out
    assert "A_TIRE" not in os.environ
    assert "does not reach the workers of a cluster" in typed(*sweep, "sweep.workers=dask:2").err


@pytest.mark.parametrize("launcher", ["basic", "joblib", "submitit_local"])
@pytest.mark.slow
def test_any_launcher_writes_the_same_runs(typed: Typed, launcher: str) -> None:
    plugin = launcher.partition("_")[0]
    if launcher != "basic" and find_spec(f"hydra_plugins.hydra_{plugin}_launcher") is None:
        pytest.skip("the extra `launchers` is not installed")
    sweep = ["-m", "seed=1,2", "optimizer.batch=5,10"]
    ended = typed(f"hydra/launcher={launcher}", *sweep)
    assert ended.code == 0, ended.err
    assert len(ended.ids) == 4
    again = typed(*sweep)
    assert "4 runs: 4 done before" in again.out
    assert again.ids == ended.ids


def test_a_launcher_that_is_not_installed_names_its_extra(typed: Typed) -> None:
    if find_spec("hydra_plugins.hydra_joblib_launcher") is not None:
        pytest.skip("the extra `launchers` is installed")
    ended = typed("-m", "hydra/launcher=joblib", "seed=1,2")
    assert ended.code == 2
    assert "hydra/launcher=joblib: is not installed; pip install 'miho[launchers]'" in ended.err


@pytest.mark.parametrize("launcher", ["basic", pytest.param("pool", marks=pytest.mark.slow)])
def test_optuna_tunes_the_settings_of_a_method(typed: Typed, tmp_path: Path, launcher: str) -> None:
    """A whole number between whole ends, a choice; trials are runs, and the study goes on."""
    storage = f"sqlite:///{tmp_path / 'tuning.db'}"
    tuning = [
        "-m", "hydra/sweeper=optuna", "hydra.sweeper.study_name=mine", "optimizer=miho",
        "optimizer.R=interval(5,50)", "optimizer.eta=choice(3,4)", f"hydra/launcher={launcher}",
        f"hydra.sweeper.storage={storage}",
    ]  # fmt: skip
    ended = typed(*tuning, "hydra.sweeper.n_trials=2", tiny=False)
    assert ended.code == 0, ended.err
    trials = _trials(storage)
    settings = [run.config["optimizer"] for run in _stored(ended.root)]
    stored = {(s["R"], s["eta"]): e for s, e in zip(settings, _errors(ended.root), strict=True)}
    for trial in trials:
        key = trial.params["optimizer.R"], trial.params["optimizer.eta"]
        assert stored[key] == pytest.approx(trial.value, rel=1e-12)  # the root of a square
        assert 5 <= trial.params["optimizer.R"] <= 50
    (best,) = ended.hydra("multirun", "optimization_results.yaml")
    assert yaml.safe_load(best.read_text())["best_value"] == min(trial.value for trial in trials)
    ended = typed(*tuning, "hydra.sweeper.n_trials=3", tiny=False)
    assert ended.code == 0, ended.err
    assert len(_trials(storage)) == 3


def _trials(url: str) -> list[optuna.trial.FrozenTrial]:
    """The trials of the study, as its dashboard reads them."""
    storage = optuna.storages.RDBStorage(url)
    try:
        return optuna.load_study(study_name="mine", storage=storage).get_trials()
    finally:
        storage.remove_session()
        storage.engine.dispose()


def _stored(root: Path) -> list[StoredRun]:
    return [read_run(Path(folder)) for folder in load_runs(root).runs["folder"]]


def _errors(root: Path) -> list[float]:
    errors: list[float] = load_runs(root).runs["error"].tolist()
    return errors


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["hydra.sweeper.direction=up", "seed=choice(1,2)"], "direction: is 'up'; expected min"),
        (["hydra.sweeper.n_trials=0", "seed=choice(1,2)"], "n_trials: is 0; expected at least 1"),
        ([], "hydra.sweeper.params: is empty"),
        (["sweep.dry_run=true", "seed=choice(1,2)"], "sweep.dry_run=true: lists no trials"),
        (["seed=interval(1,x)"], "cannot be read"),
        (["seed=range(3)", "hydra.sweeper.storage=sqlite:///x.db"], "study_name: is missing"),
    ],
)
@pytest.mark.slow
def test_a_study_that_cannot_be_is_one_line(
    typed: Typed, arguments: list[str], message: str
) -> None:
    ended = typed("-m", "hydra/sweeper=optuna", *arguments)
    assert ended.code == 2
    assert message in ended.err
    assert ended.err.count("\n") == 1


@pytest.mark.slow
def test_a_command_is_a_script_too(tmp_path: Path) -> None:
    for command in ("identify", "compare", "drive", "drive_study"):
        process = subprocess.run(
            [sys.executable, f"experiments/{command}.py", "--cfg", "job", f"root={tmp_path}"],
            cwd=ROOT, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": ""},
        )  # fmt: skip
        assert process.returncode == 0, process.stderr
        assert f"root: {tmp_path}" in process.stdout
    script = ["experiments/identify.py", "-m", "seed=1,2", *TINY, f"root={tmp_path}"]
    process = subprocess.run(
        [sys.executable, ROOT / script[0], *script[1:]],
        cwd=tmp_path, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": ""},
    )  # fmt: skip
    assert "2 runs: 2 ran" in process.stdout, process.stderr


NEEDS_A_SETTING = {
    "axle_log", "brake_log", "csv", "mat", "published", "tir", "torque_log", "zero_residuals"
}  # fmt: skip
NEEDS_A_FILE = {"fmu", "function", "published", "residual_system", "trajectory"}
LIBRARIES = {"ngopt": "nevergrad", "dehb": "dehb", "dfo_ls": "dfols"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("group", "kind", "needs"),
    [("optimizer", Optimizer, set()), ("model", Model, NEEDS_A_FILE),
     ("dataset", Dataset, NEEDS_A_SETTING)],
)  # fmt: skip
def test_a_notebook_composes_and_instantiates(
    group: str, kind: type, needs: set[str], request: pytest.FixtureRequest,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Every method, model and dataset that needs no file of the user's."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        for option in options_of(group):
            if option in needs or (option in LIBRARIES and find_spec(LIBRARIES[option]) is None):
                continue
            if option.startswith("seong"):
                monkeypatch.setenv("MIHO_DATA_DIR", str(request.getfixturevalue("reference_data")))
            cfg = compose("config", [f"{group}={option}"])
            assert isinstance(instantiate(cfg[group]), kind), option


def test_no_command_imports_what_hydra_keeps_to_itself() -> None:
    for path in [*(ROOT / "experiments").rglob("*.py"), *(ROOT / "tests").rglob("*.py")]:
        imports = re.findall(r"^\s*(?:from|import) (\S+)", path.read_text(encoding="utf-8"), re.M)
        assert not [name for name in imports if name.startswith("hydra._")], path


def test_seeds_of_one_setting_share_a_composition(
    typed: Typed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Composing takes a tenth of a second, and Hydra's sweeper composes each job to check it."""
    settings: list[list[str]] = []

    class Counted(launch.Compositions):
        def __init__(self, compose: Callable[..., Any]) -> None:
            super().__init__(lambda *given: (settings.append(given[1]), compose(*given))[1])

    monkeypatch.setattr(launch, "Compositions", Counted)
    assert typed("-m", "optimizer=random,least_squares", "seed=0,1,2", tiny=False).code == 0
    methods = [overrides[-1] for overrides in settings]
    assert methods == ["optimizer=random", "optimizer=least_squares"]
