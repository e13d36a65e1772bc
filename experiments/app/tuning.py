"""The study of `hydra/sweeper=optuna`: its search space, its trials and its result."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import optuna
from hydra.core.override_parser.types import (
    ChoiceSweep,
    IntervalSweep,
    Override,
    RangeSweep,
    Transformer,
)
from hydra.plugins.launcher import Launcher
from omegaconf import DictConfig, OmegaConf
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)
from optuna.storages import RDBStorage
from optuna.study import StudyDirection
from optuna.trial import Trial, TrialState

from experiments.app.explain import ConfigError, parse_overrides

if TYPE_CHECKING:
    from experiments.plugins.hydra_plugins.miho_optuna import OptunaSweeper

FINISHED = (TrialState.COMPLETE, TrialState.FAIL, TrialState.PRUNED)
DIRECTIONS = ("minimize", "maximize")
ENDED_EARLY = "ended_early"
"""Attribute of trials that a signal ended, or that could not start; they are not counted."""
RESULTS = "optimization_results.yaml"
"""File of the best trial in the folder of the sweep."""


def tune(
    sweeper: OptunaSweeper, launcher: Launcher, config: DictConfig, arguments: Sequence[str]
) -> None:
    """Ask for trials, execute them and report their errors until the study has `n_trials`."""
    _check(sweeper)
    if config.sweep.dry_run:
        raise ConfigError(
            "sweep.dry_run=true: lists no trials, because each depends on the results of earlier "
            "ones; leave it out"
        )
    space, fixed = search_space(sweeper.params, arguments, config)
    with _study(sweeper) as study:
        folder = Path(config.hydra.sweep.dir)
        folder.mkdir(parents=True, exist_ok=True)
        OmegaConf.save(config, folder / "multirun.yaml")
        number = 0
        while (left := sweeper.n_trials - _finished(study)) > 0:
            trials = [study.ask(space) for _ in range(min(left, sweeper.n_jobs))]
            batch = [[*fixed, *_words(trial)] for trial in trials]
            try:
                sweeper.validate_batch_is_legal(batch)
                returned = launcher.launch(batch, initial_job_idx=number)
                errors = [float(job.return_value) for job in returned]
            except BaseException:
                for trial in trials:  # the next call starts with them
                    trial.set_user_attr(ENDED_EARLY, True)
                    study.tell(trial, state=TrialState.FAIL)
                    study.enqueue_trial(trial.params)
                raise
            number += len(batch)
            for trial, error in zip(trials, errors, strict=True):
                known = math.isfinite(error)
                study.tell(trial, error if known else None, None if known else TrialState.FAIL)
                if known:
                    words = " ".join(_words(trial))
                    print(f"trial {trial.number}: {error:.6g} with {words}", flush=True)
            failed = sum(not math.isfinite(error) for error in errors)
            if failed > sweeper.max_failure_rate * len(errors):
                print(
                    f"{failed} of {len(errors)} trials have no result, so the study ends; "
                    "hydra.sweeper.max_failure_rate is the share that may fail",
                    file=sys.stderr,
                )
                break
        _save_best(study, folder)


def search_space(
    params: dict[str, Any], arguments: Sequence[str], config: DictConfig
) -> tuple[dict[str, BaseDistribution], list[str]]:
    """Distributions of the tuned settings, and the overrides that all trials share.

    Parameters
    ----------
    params
        Settings and their values or sweeps, as configured.
    arguments
        Overrides; they replace `params` of the same setting.
    config
        The composed configuration. If a setting is an integer there, an interval between integers
        gives integers; Hydra reads the ends as real numbers.
    """
    texts = [*(f"{key}={value}" for key, value in params.items()), *arguments]
    last = {override.get_key_element(): override for override in parse_overrides(texts)}
    space = {
        key: _distribution(key, override, whole=type(OmegaConf.select(config, key)) is int)
        for key, override in last.items()
        if override.is_sweep_override()
    }
    fixed = [str(override.input_line) for key, override in last.items() if key not in space]
    if not space:
        raise ConfigError(
            "hydra.sweeper.params: is empty; give a setting to tune, such as "
            "'optimizer.R=interval(100, 10000)'"
        )
    return space, fixed


def _distribution(key: str, override: Override, *, whole: bool) -> BaseDistribution:
    """Distribution of a `choice()`, `range()` or `interval()`; with tag(log, ...) logarithmic."""
    value = override.value()
    if isinstance(value, ChoiceSweep):
        choices = override.sweep_iterator(transformer=Transformer.encode)
        return CategoricalDistribution([_plain(choice) for choice in choices])
    log = "log" in getattr(value, "tags", ())
    if isinstance(value, RangeSweep) and value.start is not None and value.stop is not None:
        if all(isinstance(n, int) for n in (value.start, value.stop, value.step)):
            # The range of Hydra excludes its end, as in Python.
            last = list(range(int(value.start), int(value.stop), int(value.step)))[-1]
            return IntDistribution(int(value.start), last, log=log, step=int(value.step))
        return FloatDistribution(value.start, value.stop, log=log, step=value.step)
    if isinstance(value, IntervalSweep) and value.start is not None and value.end is not None:
        ends = (value.start, value.end)
        if all(isinstance(end, int) or (whole and end.is_integer()) for end in ends):
            return IntDistribution(int(value.start), int(value.end), log=log)
        return FloatDistribution(value.start, value.end, log=log)
    raise ConfigError(
        f"{key}: is {override.get_value_element_as_str()}; expected choice(), range() or "
        "interval() with its ends"
    )


def _plain(choice: object) -> str | int | float | bool | None:
    """A choice as Optuna stores it: plain values unchanged, other values as text."""
    if choice is None or isinstance(choice, str | int | float | bool):
        return choice
    return str(choice)


def _check(sweeper: OptunaSweeper) -> None:
    if sweeper.direction not in DIRECTIONS:
        raise ConfigError(
            f"hydra.sweeper.direction: is {sweeper.direction!r}; expected minimize or maximize"
        )
    for key in ("n_trials", "n_jobs"):
        if getattr(sweeper, key) < 1:
            raise ConfigError(
                f"hydra.sweeper.{key}: is {getattr(sweeper, key)}; expected at least 1"
            )


@contextmanager
def _study(sweeper: OptunaSweeper) -> Iterator[optuna.Study]:
    """Context with a new or continued study, whose database is closed afterwards."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    if sweeper.storage is not None and sweeper.study_name is None:
        raise ConfigError("hydra.sweeper.study_name: is missing; give a name for the storage")
    storage = None if sweeper.storage is None else RDBStorage(sweeper.storage)
    study = optuna.create_study(
        study_name=sweeper.study_name,
        storage=storage,
        sampler=sweeper.sampler,
        direction=StudyDirection[sweeper.direction.upper()],
        load_if_exists=True,
    )
    if study.get_trials(deepcopy=False):  # the same seed would repeat the first trials
        sweeper.sampler.reseed_rng()
    try:
        yield study
    finally:
        if storage is not None:
            storage.remove_session()
            storage.engine.dispose()


def _finished(study: optuna.Study) -> int:
    """Number of trials of the study that have ended regularly."""
    trials = study.get_trials(deepcopy=False, states=FINISHED)
    return sum(ENDED_EARLY not in trial.user_attrs for trial in trials)


def _words(trial: Trial) -> list[str]:
    """Settings of a trial as Hydra reads them; JSON has the same null, true and false."""
    texts = ((k, v if isinstance(v, str) else json.dumps(v)) for k, v in trial.params.items())
    return list(map("=".join, texts))


def _save_best(study: optuna.Study, folder: Path) -> None:
    """Print the best trial and write it to the folder of the sweep."""
    if not study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)):
        return
    best = study.best_trial
    words = " ".join(f"{key}={value}" for key, value in best.params.items())
    print(f"best of {len(study.trials)} trials: {best.value:.6g} with {words}")
    result = {"name": "optuna", "best_params": dict(best.params), "best_value": best.value}
    OmegaConf.save(OmegaConf.create(result), folder / RESULTS)
