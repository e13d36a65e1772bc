"""The launcher `pool`: plans the runs of a multirun, executes them, and returns their errors.

Jobs that differ only in their seed are planned together and share one composition, because a
composition takes a tenth of a second.
"""

import math
import re
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import indent
from typing import Any

from hydra.conf import HydraConf
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn, JobStatus
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf, open_dict
from tqdm import tqdm

from experiments.app.build import Settings, plain
from experiments.app.compose import as_typed, job_config
from experiments.app.console import OK, Job
from experiments.app.explain import ConfigError
from experiments.app.plan import Request, Trials, requests, sweep_settings
from experiments.app.run_text import print_summary
from experiments.app.runs import run
from experiments.app.working import State

RECORDED = ("hydra/sweeper", "hydra.sweeper", "hydra.searchpath", "hydra.job.env_set")
"""Beginnings of overrides of Hydra that change the runs of a sweep."""
IN_A_SWEEP = {
    "problems": "problem=NAME",
    "methods": "optimizer=NAME,NAME",
    "repetitions": "'seed=range(5)'",
    "target": "budget.target=LOSS",
}
"""Settings of an arena, and an override of a sweep that takes their place."""
COMPOSING, MANY = "composing the settings of the sweep, about 0.1 s each", 20
"""A line, and the number of settings after which it is printed."""
SEED = re.compile(r"seed=\d+", re.ASCII)
"""An override of the seed; Hydra composes others, such as `seed=${oc.env:NAME}`."""
WHOLE = ("fresh", "sweep", "tracking")
"""Keys of the execution, which all jobs share."""
HOW_TO_RUN = ("seed", "fresh", "sweep", "hydra")
"""Keys of the seed and of the execution, which do not describe the setting of a run."""


@dataclass
class Sweep:
    """The runs of a multirun so far, with its configuration and the typed overrides."""

    cfg: DictConfig
    typed: Sequence[str]
    plan: list[Request] = field(default_factory=list)
    states: list[State] = field(default_factory=list)

    def summed_up(self) -> int:
        """Print a summary of the runs; return the exit code."""
        return print_summary(self.states) if self.states else OK


class Compositions:
    """Composes each setting of a batch of jobs once, in place of Hydra's function `compose`.

    The sweeper of Hydra composes all jobs to check them. The seed of a job is set later.
    """

    def __init__(self, compose: Callable[[DictConfig, list[str]], DictConfig]) -> None:
        self.compose = compose
        self.made: dict[tuple[str, ...], DictConfig] = {}

    def __call__(self, master_config: DictConfig, sweep_overrides: list[str]) -> DictConfig:
        """Configuration of the setting of a job, with the node `hydra`."""
        setting = _setting(sweep_overrides)
        if setting not in self.made:
            if len(self.made) == MANY:
                print(COMPOSING, file=sys.stderr)
            self.made[setting] = self.compose(master_config, list(setting))
        return self.made[setting]


@dataclass(frozen=True)
class _Job:
    """One job of Hydra: its number, its overrides, its overrides without the seed, and the seed."""

    number: int
    overrides: tuple[str, ...]
    setting: tuple[str, ...]
    seed: int | None


def launch(
    job_overrides: Sequence[Sequence[str]],
    first: int,
    context: HydraContext,
    task: TaskFunction,
    config: DictConfig,
    settings: Mapping[str, Any],
) -> list[JobReturn]:
    """Execute the unfinished runs of a batch of jobs; return their errors, NaN without a result.

    A run that fails or is lost stops no other run and raises no exception: the sweep prints it and
    sets the exit code. Raises ConfigError before the first run if a job cannot be built, and the
    interrupt if a signal ended the batch.
    """
    if not isinstance(task, Job) or not task.pool:
        raise ConfigError(
            "hydra/launcher=pool: works only with experiments.identify and experiments.compare; "
            "choose hydra/launcher=basic here"
        )
    if config.hydra.job.chdir:
        raise ConfigError(
            "hydra.job.chdir=true: has no effect on runs of the pool; add hydra/launcher=basic, or "
            "leave it out"
        )
    _refuse_arena(config)
    jobs = [_job(number, texts) for number, texts in enumerate(job_overrides, first)]
    if not jobs:
        within = (
            "; a glob without a match has none, and it finds no options in folders of a group, "
            "such as r500"
        ) * any("glob(" in text for text in as_typed(config.hydra.overrides.task))
        raise ConfigError(f"-m: has no values to sweep over; give some, such as seed=0,1{within}")
    if task.sweep is None:
        cfg = job_config(_copied(config), config.hydra)
        task.sweep = Sweep(cfg, typed(config.hydra, task.config_name))
    sweep, checked = task.sweep, sweep_settings(settings)
    if config.hydra.job.env_set and isinstance(checked.workers, str):
        raise ConfigError(
            "hydra.job.env_set: does not reach the workers of a cluster; set the variables there"
        )
    compose = context.config_loader.load_sweep_config
    settings_of_jobs = dict.fromkeys(job.setting for job in reversed(jobs))
    composed = {setting: compose(config, list(setting)) for setting in settings_of_jobs}
    for key in WHOLE:
        if any(job[key] != config[key] for job in composed.values()):
            raise ConfigError(
                f"{key}: holds for the whole sweep; give one value for all jobs, on the command "
                "line or in an experiment that all of them have"
            )
    plan = _planned(jobs, composed, checked.time_limit)
    _announce(jobs, composed, context, task)
    outcome = run(
        plan,
        checked,
        fresh=config.fresh,
        command=f"experiments.{task.task.__name__} -m",
        overrides=sweep.typed,
        tracking=config.tracking,
    )
    sweep.plan += plan
    sweep.states += outcome.states
    outcome.raise_if_stopped()
    states = {state.request.key: state for state in outcome.states}
    errors = [states[request.key].error for request in plan]
    return [
        _returned(job, error, composed[job.setting], context)
        for job, error in zip(jobs, errors, strict=True)
    ]


def _refuse_arena(config: DictConfig) -> None:
    """Raise ConfigError for a setting of an arena, which a sweep would ignore."""
    texts = as_typed(config.hydra.overrides.task)
    words = [text.lstrip("+").partition("=")[0] for text in texts]
    for key, instead in IN_A_SWEEP.items():
        name = f"comparison.{key}"
        typed = any(word == name or word.startswith(f"{name}.") for word in words)
        if typed or (key == "problems" and config.comparison[key]):
            raise ConfigError(
                f"{name}: is for an arena, and this is a sweep; start an arena with python -m "
                f"experiments.compare experiment=arena_small, or write {instead} here"
            )


def _setting(texts: Sequence[str]) -> tuple[str, ...]:
    return tuple(text for text in texts if not SEED.fullmatch(text))


def _job(number: int, texts: Sequence[str]) -> _Job:
    seeds = [int(text[5:]) for text in texts if SEED.fullmatch(text)]
    return _Job(number, tuple(texts), _setting(texts), seeds[-1] if seeds else None)


def _planned(
    jobs: Sequence[_Job], composed: Mapping[tuple[str, ...], DictConfig], time_limit: float | None
) -> list[Request]:
    """Plan the runs setting by setting; return them in the order of the jobs.

    If there are several settings and the model of one cannot be built, only its runs are lost.
    """
    planned: dict[int, Request] = {}

    def plan(setting: tuple[str, ...], config: DictConfig, lose: bool) -> None:
        same = [job for job in jobs if job.setting == setting]
        cfg = job_config(_copied(_of_job(same[0], config)), config.hydra)
        words = " ".join(_for_shell(text) for text in setting if not _is_of(text, HOW_TO_RUN))
        alike: dict[str, dict[int, Settings]] = {}  # by job; ${seed} and ${hydra:...} make groups
        for job in same:
            cfg.seed = _of_job(job, config).seed
            whole = plain(cfg)
            alike.setdefault(str({**whole, "seed": None}), {})[job.number] = whole
        for wholes in alike.values():
            seeds = [whole["seed"] for whole in wholes.values()]
            of_seeds = requests(next(iter(wholes.values())), words, seeds, trials, lose=lose)
            planned.update(zip(wholes, of_seeds, strict=True))

    with Trials(time_limit) as trials:
        for setting, config in tqdm(composed.items(), "checking", leave=False, disable=None):
            plan(setting, config, lose=len(composed) > 1)
        if len(composed) > 1 and all(request.lost for request in planned.values()):
            plan(*next(iter(composed.items())), lose=False)  # raises the error that they share
    return [planned[job.number] for job in jobs]


def _for_shell(text: str) -> str:
    """An override as it is typed: blanks, which Hydra's sweeper escapes, are between quotes."""
    return shlex.quote(text.replace("\\ ", " ")) if "\\" in text else text


def _copied(config: DictConfig) -> DictConfig:
    copy: DictConfig = OmegaConf.masked_copy(config, [str(key) for key in config if key != "hydra"])
    return copy


def _is_of(text: str, keys: Sequence[str]) -> bool:
    """Whether the key of an override, such as sweep.workers=2, is one of these or below one."""
    return text.lstrip("+~").partition("=")[0].partition(".")[0].partition("/")[0] in keys


def typed(node: HydraConf, usual: str) -> list[str]:
    """Own configuration, folders of options and overrides of a command, for its record in the root.

    `node` is Hydra's configuration, and `usual` the name of the command's own. Settings that change
    no result are left out.
    """
    sources = node.runtime.config_sources
    folders = [Path(source.path) for source in sources if source.provider == "command-line"]
    here = Path.cwd()
    folders = [path.relative_to(here) if path.is_relative_to(here) else path for path in folders]
    overrides = [x for x in as_typed(node.overrides.task) if not _is_of(x, ("fresh", "sweep"))]
    of_hydra = [x for x in as_typed(node.overrides.hydra) if x.lstrip("+").startswith(RECORDED)]
    name = str(node.job.config_name)
    own = [] if name == usual else [f"--config-name={name}"]
    return [*(f"--config-dir={folder}" for folder in folders), *own, *overrides, *of_hydra]


def _announce(
    jobs: Sequence[_Job],
    composed: Mapping[tuple[str, ...], DictConfig],
    context: HydraContext,
    task: TaskFunction,
) -> None:
    """Write the `.hydra` folder of each job, and call Hydra's callbacks for its start."""
    texts = {setting: OmegaConf.to_yaml(_copied(config)) for setting, config in composed.items()}
    for job in jobs:
        config = _of_job(job, composed[job.setting])
        subdir = config.hydra.output_subdir
        if subdir is not None:
            folder = Path(config.hydra.runtime.output_dir, subdir)
            folder.mkdir(parents=True, exist_ok=True)
            for name, text in _records(config, texts[job.setting]):
                (folder / name).write_text(text, encoding="utf-8")
        context.callbacks.on_job_start(config=config, task_function=task)


def _records(config: DictConfig, text: str) -> Iterator[tuple[str, str]]:
    """Names and texts of the files that Hydra writes for each job; `text` may have another seed."""
    yield "config.yaml", re.sub("^seed:.*", f"seed: {config.seed}", text, flags=re.MULTILINE)
    yield "hydra.yaml", "hydra:\n" + indent(OmegaConf.to_yaml(config.hydra), "  ")
    yield "overrides.yaml", OmegaConf.to_yaml(config.hydra.overrides.task)


def _of_job(job: _Job, config: DictConfig) -> DictConfig:
    """Configuration of a job, also for ${hydra:...}; the next call for the setting changes it."""
    HydraConfig.instance().cfg = config  # type: ignore[assignment]
    with open_dict(config):
        if job.seed is not None:
            config.seed = job.seed
        node = config.hydra
        node.job.id, node.job.num = str(job.number), job.number
        node.overrides.task = list(job.overrides)
        naming = node.job.config.override_dirname
        named = sorted(
            text for text in job.overrides if text.partition("=")[0] not in naming.exclude_keys
        )
        pairs = (text.replace("=", naming.kv_sep, 1) for text in named)
        node.job.override_dirname = naming.item_sep.join(pairs)
        node.runtime.output_dir = str(Path(node.sweep.dir, str(node.sweep.subdir)).absolute())
    return config


def _returned(
    job: _Job, error: float | None, config: DictConfig, context: HydraContext
) -> JobReturn:
    """Result of a job for the sweepers and callbacks of Hydra."""
    returned = JobReturn(
        overrides=list(job.overrides),
        task_name=config.hydra.job.name,
        working_dir=str(Path.cwd()),
        status=JobStatus.COMPLETED,
        _return_value=math.nan if error is None else error,
    )
    context.callbacks.on_job_end(config=_of_job(job, config), job_return=returned)
    return returned
