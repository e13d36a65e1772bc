"""Plan of a sweep: the requested runs (a configuration and a seed each) and their identities."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from experiments.app.build import (
    MEANS,
    Experiment,
    Settings,
    build,
    build_dataset,
    build_problem,
    method_of,
    plain,
    runs_own_code,
)
from experiments.app.explain import BAD_SETTINGS, ConfigError, as_config_error, one_line
from experiments.app.origin import our_code
from experiments.app.parts import model_files, own_files
from experiments.app.schema import SweepConfig
from miho import CurveFit, Dataset
from miho.parallel.cluster import ADDRESSES, ClusterError, check_address, is_address
from miho.parallel.workers import JobOutcome, Workers
from miho.study import Identity
from miho.study.identity import sha256

PROBLEM = ("model", "dataset", "space", "loss", "problem")
NAMELESS = "model"
POLL = 0.2
MODULES = ("experiments.app.runs", "scipy.special")
"""Modules that a worker process imports before its first run."""


@dataclass(frozen=True)
class Request:
    """One requested run: its overrides, its configuration in JSON, and its identity.

    `own_code`: a file of the user is run. `lost`: the reason why the run cannot start.
    `experiment`: the objects of the run, if this process executes it.
    """

    words: str
    setting: str
    identity: Identity
    root: str
    own_code: bool = False
    lost: str | None = None
    experiment: Experiment | None = field(default=None, compare=False)

    @property
    def key(self) -> tuple[str, str]:
        """Folder of results and identity: requests with the same key are for one run."""
        return str(Path(self.root).absolute()), self.identity.id


def request_of(experiment: Experiment, cfg: Settings, words: str = "") -> Request:
    """Request of a run that is built already and that this process executes."""
    root = str(experiment.root)
    return Request(words, _text(plain(cfg)), experiment.identity, root, experiment=experiment)


def requests(
    cfg: Settings,
    words: str,
    seeds: Sequence[int],
    trials: Trials | None = None,
    *,
    lose: bool = False,
) -> list[Request]:
    """Requests of one configuration with several seeds; raises ConfigError for bad input.

    The user's files are tried in a separate process (`trials`). If that process ends, or if `lose`
    is true and the run cannot be built, only these runs are lost.
    """
    for seed in seeds:
        if seed < 0:
            raise ConfigError(f"seed: is {seed}; expected a whole number of at least 0")
    setting = plain(cfg)
    text, root = _text(setting), str(setting["root"])
    own_code, lost = runs_own_code(setting), None
    if own_code:
        try:
            with nullcontext(trials) if trials else Trials() as trying:
                identity, lost = trying.identity_of(text)
        except ConfigError as error:
            if not lose:
                raise
            identity, lost = _named_only(setting), str(error)
    else:
        identity = experiment_of(text).identity
    return [
        Request(f"{words} seed={s}".strip(), text, replace(identity, seed=s), root, own_code, lost)
        for s in seeds
    ]


class Trials(AbstractContextManager["Trials"]):
    """A process in which configurations with files of the user are tried, within a time limit [s].

    It starts with the first trial, and each trial has a fork of it.
    """

    def __init__(self, time_limit: float | None = None) -> None:
        self._time_limit = time_limit
        self._workers: Workers[str, Identity | str] | None = None

    def __exit__(self, *_: object) -> None:
        if self._workers is not None:
            self._workers.kill()

    def identity_of(self, text: str) -> tuple[Identity, str | None]:
        """Identity of a run of a configuration in JSON.

        If the process ends, return the identity of `_named_only` and the reason. Raises ConfigError
        for faults that the user can correct.
        """
        if self._workers is None:
            self._workers = Workers(
                _identity, 1, self._time_limit, MODULES, prepare=_prepare, alone=bool
            )
        self._workers.start(text)
        ended: list[JobOutcome[str, Identity | str]] = []
        while not ended:
            ended = self._workers.wait(POLL)
        identity = ended[0].result
        if isinstance(identity, str):
            raise ConfigError(identity)
        if identity is not None:
            return identity, None
        return _named_only(setting_of(text)), ended[0].reason


def sweep_settings(given: Mapping[Any, Any]) -> SweepConfig:
    """Checked settings of `sweep`; raises ConfigError."""
    settings = SweepConfig(**{str(key): value for key, value in given.items()})
    workers = settings.workers
    if isinstance(workers, str) and workers.isdecimal():  # of ${oc.env:NAME}
        workers = int(workers)
        settings = replace(settings, workers=workers)
    if is_address(workers):
        with as_config_error("sweep.workers", ClusterError):
            check_address(workers)
    elif isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise ConfigError(
            f"sweep.workers: is {workers}; expected at least 1, or an address: {ADDRESSES}"
        )
    if settings.time_limit is not None and not settings.time_limit > 0:
        raise ConfigError(f"sweep.time_limit: is {settings.time_limit}; expected seconds above 0")
    return settings


def _text(setting: Mapping[str, Any]) -> str:
    with as_config_error("configuration", BAD_SETTINGS):
        return json.dumps(setting)


@lru_cache(maxsize=32)
def setting_of(text: str) -> Mapping[str, Any]:
    """Configuration from its JSON text; callers must not change it."""
    setting: Mapping[str, Any] = json.loads(text)
    return setting


@lru_cache(maxsize=32)
def experiment_of(text: str) -> Experiment:
    """Objects that all seeds of a configuration share, built once."""
    setting = setting_of(text)
    if runs_own_code(setting):
        return build(setting, build_problem(setting, dataset_of(text)))
    return build(setting, problem_of(setting))


def problem_of(setting: Mapping[str, Any]) -> CurveFit:
    """Problem of a configuration, which all methods share."""
    return _problem(json.dumps({key: setting[key] for key in PROBLEM}))


@lru_cache(maxsize=2)
def _problem(text: str) -> CurveFit:
    return build_problem(json.loads(text))


@lru_cache(maxsize=2)
def dataset_of(text: str) -> Dataset | None:
    """Data of a configuration in JSON; None for a joint problem, whose parts read their data."""
    setting = setting_of(text)
    return None if setting["problem"]["parts"] else build_dataset(setting["dataset"])


def _prepare(_: str) -> None:
    """In a worker, before each fork: read the code of which all trials need the digest."""
    our_code(frozenset({CurveFit.__module__, "miho.optim.minimize"}))


def _identity(text: str) -> Identity | str:
    """In a worker: the identity of a run of this configuration, or an error message."""
    try:
        return build(setting_of(text)).identity
    except Exception as error:  # noqa: BLE001 -- whatever the user's file raises, they can correct
        return one_line(error)


def _code_of(setting: Mapping[str, Any]) -> str:
    """SHA-256 of the user's files; of the empty string if there is no file."""
    paths = map(Path, own_files(setting))
    return sha256(b"".join(path.read_bytes() for path in paths if path.is_file()))


def _named_only(setting: Mapping[str, Any]) -> Identity:
    """Identity of a run that cannot be built, with the name of a model's file as model name."""
    optimizer = method_of(setting)
    config = {key: value for key, value in setting.items() if key not in MEANS}
    about: dict[str, Any] = {
        "optimizer": optimizer,
        "seed": 0,
        "config": config,
        "code": _code_of(setting),
        "data": "",
    }
    try:
        return Identity(Path([*model_files(setting), NAMELESS][0]).stem, **about)
    except ValueError:  # the name cannot be a folder
        return Identity(NAMELESS, **about)
