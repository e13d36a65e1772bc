"""Build the problem, the method and the identity of a run from a composed configuration."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import DictConfig, OmegaConf

from experiments.app.explain import BAD_SETTINGS, as_config_error, unknown_message
from experiments.app.explain import ConfigError as ConfigError
from experiments.app.instantiation import MISSING, instantiate, part_of
from experiments.app.origin import code_of, packages_of
from experiments.app.parts import model_files, own_files, part_nodes, with_local
from experiments.app.safety import check_no_secret, check_root
from experiments.app.schema import Config, ParameterConfig, ProblemConfig
from miho import Budget, Dataset, Optimizer, Parameter, Space
from miho.fitting.joint_problem import SIGMA as DEVIATION
from miho.fitting.joint_problem import Joint, Measured
from miho.identification import CurveFit, Loss, linear_optimum
from miho.identification.constraints import constrained
from miho.identification.irreducible import irreducible_of
from miho.models import Model
from miho.models.layout import PART
from miho.parallel.cluster import is_address
from miho.parallel.pool import number_of
from miho.study import Identity, Store, StoredRun
from miho.validate import positive

Settings = DictConfig | Mapping[str, Any]
"""A composed configuration, or the plain data that `plain` returns."""
MEANS = ("workers", "evaluation_limit")
"""Settings of how a run is executed; they are not part of its identity."""
PARTS = (
    "model", "dataset", "space", "loss", "problem", "optimizer", "method", "budget", "seed", "root",
)  # fmt: skip


@dataclass(frozen=True)
class Experiment:
    """One run, ready to start, with the `workers` and limit [s] of its evaluations."""

    problem: CurveFit
    optimizer: Optimizer
    budget: Budget
    identity: Identity
    root: Path
    optimum: float | None = None
    workers: int | str = 1
    evaluation_limit: float | None = None

    @property
    def facts(self) -> dict[str, Any]:
        """Stored facts about the problem: the unit of its error, and lower bounds of the error.

        `called_as` says how the user's functions are called, so that a repeated run calls them in
        the same way. `optimum` is the smallest loss in the space, if linear algebra finds it or
        the problem records it.
        """
        facts = dict(_facts(self.problem))
        if self.optimum is not None:
            facts.setdefault("optimum", self.optimum**2)
        return facts


@lru_cache(maxsize=4)
def _facts(problem: CurveFit) -> Mapping[str, Any]:
    facts: dict[str, Any] = {"unit": problem.unit}
    if any(problem.called_as):
        facts["called_as"] = problem.called_as
    floor = irreducible_of(problem)
    if math.isfinite(floor.value):
        facts["irreducible"] = floor.value
    if floor.resolved:
        facts |= {"irreducible_low": floor.low, "irreducible_high": floor.high}
    optimum = linear_optimum(problem)
    if optimum is not None:
        facts["optimum"] = optimum[1]
    return facts


def plain(cfg: Settings) -> Mapping[str, Any]:
    """Return the resolved configuration of one run as plain data; plain data is returned unchanged.

    Raises ConfigError for an unknown key.
    """
    if not isinstance(cfg, DictConfig):
        return cfg
    allowed = [field.name for field in fields(Config)]
    for key in cfg:
        if key not in allowed:
            raise ConfigError(unknown_message(str(key), allowed))
    setting: dict[str, Any] = {}
    for key in (*PARTS, *MEANS):
        node = MISSING if OmegaConf.is_missing(cfg, key) else cfg[key]
        whole = OmegaConf.is_config(node)
        value = OmegaConf.to_container(node, resolve=True) if whole else node
        setting[key] = _one_spelling(value)
    return setting


def _one_spelling(node: Any, key: str = "") -> Any:
    """The settings of a node with one spelling of each path: `./my.csv` is `my.csv`."""
    if isinstance(node, dict):
        return {name: _one_spelling(value, str(name)) for name, value in node.items()}
    is_path = key == "path" and isinstance(node, str) and node
    return Path(node).as_posix() if is_path else node


def build(cfg: Settings, problem: CurveFit | None = None) -> Experiment:
    """Check the configuration and build one run; raises ConfigError or the error of a loader.

    `problem` is the result of `build_problem` for the same configuration, if it was built before.
    The problem is not evaluated as a check if a result or an evaluation log of the run is stored.
    """
    setting = plain(cfg)
    _known(ProblemConfig, part_of(setting, "problem"), "problem")
    workers, limit = _means(setting)
    check_no_secret(setting["root"], "root")
    check_root(setting["root"])
    root = Path(setting["root"])
    if runs_own_code(setting):
        root = root.absolute()  # the user's file may change the working directory later
    optimizer = build_optimizer(setting)
    if setting["seed"] < 0:
        raise ConfigError(f"seed: is {setting['seed']}; expected a whole number of at least 0")
    untried = problem is None
    problem = build_problem(setting, expensive=True) if problem is None else problem
    with as_config_error(kinds=BAD_SETTINGS):
        budget = Budget(**_known(Budget, part_of(setting, "budget"), "budget"))
        config = {key: part_of(setting, key) for key in ("model", "dataset", "loss", "budget")}
        space = with_local(setting, part_of(setting, "space"))
        config["space"] = scaled_by(problem.dataset, space)
        config["problem"] = {"name": setting["problem"]["name"]}
        if setting["problem"]["sigma"] is not None:
            config["problem"] |= {key: setting["problem"][key] for key in SIGMA}
        if setting["problem"]["parts"]:
            config["problem"] |= _joint_settings(setting["problem"], problem)
        if setting["problem"]["constraints"]:
            config["problem"]["constraints"] = setting["problem"]["constraints"]
        identity = Identity(
            problem=problem.name,
            optimizer=method_of(setting),
            seed=setting["seed"],
            config=config | {"optimizer": part_of(setting, "optimizer")},
            code=code_of(setting, problem, optimizer),
            data=problem.dataset.digest,
            packages=packages_of(optimizer),
        )
    store = Store(root)
    if untried and not (store.has_result(identity) or store.journal(identity).is_file()):
        problem = build_problem(setting, problem.dataset)
    optimum = recorded_optimum(setting)
    return Experiment(problem, optimizer, budget, identity, root, optimum, workers, limit)


def _means(setting: Mapping[str, Any]) -> tuple[int | str, float | None]:
    """Check and return the workers of a run and the time limit of its evaluations."""
    workers, limit = setting.get("workers", 1), setting.get("evaluation_limit")
    with as_config_error():
        if not is_address(workers):
            number_of(workers)
        if limit is not None:
            positive("evaluation_limit", limit)
    return workers, limit


def runs_own_code(cfg: Settings) -> bool:
    """Whether building this configuration runs a file of the user."""
    return bool(own_files(plain(cfg)))


def recorded_optimum(cfg: Settings) -> float | None:
    """Smallest known error of a problem, at least its resolution; None if none is recorded."""
    recorded = cfg["problem"]["optimum"], cfg["problem"]["resolution"]
    return None if recorded[0] is None else max(float(value or 0.0) for value in recorded)


def build_optimizer(cfg: Settings) -> Optimizer:
    """Build only the method."""
    return instantiate(part_of(plain(cfg), "optimizer"), "optimizer", Optimizer)


def method_of(cfg: Settings) -> str:
    """Name of the method in the results: `method`, or else the name of its class."""
    setting = plain(cfg)
    target = str(part_of(setting, "optimizer").get("_target_"))
    return str(setting["method"] or target.rpartition(".")[2].lower())


def build_problem(
    cfg: Settings, dataset: Dataset | None = None, *, expensive: bool = False
) -> CurveFit:
    """Build only the problem, from `dataset` if the data were built before.

    With `expensive` the model counts as expensive and is not evaluated here.
    """
    setting = plain(cfg)
    dataset, problem_of = _statement(setting, dataset)
    space = build_space(scaled_by(dataset, with_local(setting, part_of(setting, "space"))))
    rho = instantiate(part_of(setting, "loss"), "loss", Loss)
    settings = part_of(setting, "problem")
    with as_config_error(kinds=BAD_SETTINGS):
        constraints = settings["constraints"] or ()
        return problem_of(
            space, rho=rho, label=settings["name"], constraints=constraints, expensive=expensive
        )


def _statement(
    config: Mapping[str, Any], dataset: Dataset | None = None
) -> tuple[Dataset, Callable[..., CurveFit]]:
    """Return the data and a function that builds the problem from a space and other settings."""
    settings = part_of(config, "problem")
    if settings.get("parts"):
        joint = _joint(config)

        def joint_of(space: Space, constraints: str | Sequence[str], **switches: Any) -> CurveFit:
            whole = joint.space(_in_order(space, joint.model), constraints=constraints)
            return joint.complete(whole, **switches)

        return joint.dataset, joint_of
    model = instantiate(part_of(config, "model"), "model", Model)
    if dataset is None:
        dataset = build_dataset(part_of(config, "dataset"))
    sigma = {key: settings[key] for key in SIGMA if key in settings}

    def problem_of(space: Space, constraints: str | Sequence[str], **switches: Any) -> CurveFit:
        whole = constrained(_in_order(space, model), constraints)
        return CurveFit(model, dataset, whole, **sigma, **switches)

    return dataset, problem_of


def _in_order(space: Space, model: Model) -> Space:
    """Return the space with the model's parameters in the model's order, then others by name.

    A stored run does not keep the order of a mapping.
    """
    return space.in_order(sorted(space.names)).in_order(model.parameters)


def _joint(config: Mapping[str, Any]) -> Joint:
    """Build the parts of a joint problem; settings of a part override the settings of all parts."""
    settings = part_of(config, "problem")
    parts = {}
    for name, nodes in part_nodes(config).items():
        for key, node in nodes.items():
            check_no_secret(node, key)
        place, sigma = f"problem.parts.{name}", settings["parts"][name].get("sigma")
        parts[name] = Measured(
            instantiate(nodes["model"], f"{place}.model", Model),
            instantiate(nodes["dataset"], f"{place}.dataset", Dataset),
            settings.get("sigma") if sigma is None else sigma,
        )
    with as_config_error("problem.parts"):
        return Joint(parts, settings["local"], settings.get("sigma_known", True))


def _joint_settings(settings: Mapping[str, Any], problem: CurveFit) -> dict[str, Any]:
    """Settings of a joint problem in the identity of a run, with sigma even if it was estimated."""
    sigma, index = problem.dataset[DEVIATION], problem.dataset[PART]
    parts = {}
    for k, (name, part) in enumerate(settings["parts"].items()):
        stated = settings["sigma"] if part["sigma"] is None else part["sigma"]
        parts[name] = {**part, "sigma": float(sigma[index == k][0]) if stated is None else stated}
    return {"parts": parts, "local": settings["local"], "sigma_known": problem.sigma_known}


def rebuild(stored: StoredRun, *, trusted: bool = False) -> CurveFit:
    """Build the problem of a stored run again from its configuration; the data must be the same.

    A model in a file of the user is code: it runs only if `trusted`, and it is called in the same
    way as in the stored run.
    """
    config = {
        key: stored_part(stored, key) for key in ("model", "dataset", "loss", "space", "problem")
    }
    files = model_files(config)
    if files and not trusted:
        raise ConfigError(
            f"{stored.folder}: its model is code in {', '.join(files)}; add --trust to run that "
            "file"
        )
    rho = instantiate(config["loss"], "loss", Loss)
    dataset, problem_of = _statement(config)
    if dataset.digest != stored.result.get("data"):
        raise ConfigError(f"{stored.folder}: its data have changed since; identify again")
    with as_config_error(str(stored.folder), BAD_SETTINGS):
        name, space = config["problem"].get("name"), build_space(config["space"])
        constraints = config["problem"].get("constraints") or ()
        calls = stored.result.get("facts", {}).get("called_as") or ()
        return problem_of(
            space, rho=rho, label=name, constraints=constraints, expensive=bool(calls)
        ).called(calls)


def stored_part(stored: StoredRun, key: str) -> Mapping[str, Any]:
    """Return one group of the configuration of a stored run, which must be a mapping."""
    whole = stored.config
    part = whole.get(key) if isinstance(whole, Mapping) else None
    if not isinstance(part, Mapping):
        raise ConfigError(f"{stored.folder}: its configuration has no {key}; identify again")
    return part


def build_dataset(node: Mapping[str, Any]) -> Dataset:
    """Build the dataset that `node` describes."""
    return instantiate(node, "dataset", Dataset)


SCALABLE = ("low", "high", "mean", "std", "sigma_max")
UNSET = (MISSING, None)
HELD = ("fixed", "tied", "prior")
SIGMA = ("sigma", "sigma_known")
UNBOUNDED = {"low": -math.inf, "high": math.inf}


def scaled_by(dataset: Dataset, node: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Settings of a space as numbers; `scaled` gives multiples of a column's largest magnitude.

    See `experiments.app.schema.ParameterConfig`. Raises ConfigError.
    """
    space: dict[str, dict[str, Any]] = {}
    for name, settings in node.items():
        plain = {key: value for key, value in settings.items() if key != "scaled"}
        for key in HELD:  # the identity of a run contains them only if they are set
            if plain.get(key) is None:
                plain.pop(key, None)
        scaled = dict(settings.get("scaled") or {})
        if scaled:
            prefix = f"space.{name}.scaled"
            by = scaled.pop("by", None)
            column = dataset.output if by == "output" else by
            if column not in dataset.columns:
                columns = ", ".join(("output", *dataset.columns))
                raise ConfigError(f"{prefix}.by: is {by!r}; choose from {columns}")
            unit = float(np.abs(dataset[column]).max())
            for key, multiple in scaled.items():
                if key not in SCALABLE or type(multiple) not in (int, float):
                    allowed = ", ".join(SCALABLE)
                    raise ConfigError(
                        f"{prefix}.{key}: is {multiple!r}; expected numbers for {allowed}"
                    )
                if plain.get(key) in UNSET:
                    plain[key] = multiple * unit
        space[name] = plain
    return space


def build_space(node: Mapping[str, Any]) -> Space:
    """Build a space from the settings of each parameter, which `scaled_by` resolved."""
    plain = {name: dict(settings) for name, settings in node.items()}
    for name, settings in plain.items():
        if settings.pop("scaled", None):
            raise ConfigError(f"space.{name}.scaled: needs data; give low and high")
        fixed = settings.get("fixed") is not None or settings.get("tied") is not None
        missing = [key for key, value in settings.items() if value == MISSING]
        if fixed:
            settings.update({key: end for key, end in UNBOUNDED.items() if key in missing})
            missing = [key for key in missing if key not in UNBOUNDED]
        if missing:
            raise ConfigError(f"space.{name}.{missing[0]}: is missing; expected unit, low and high")
        _known(ParameterConfig, settings, f"space.{name}")
    with as_config_error("space", BAD_SETTINGS):
        return Space(tuple(Parameter(name, **settings) for name, settings in plain.items()))


def _known(kind: type, settings: dict[str, Any], key: str) -> dict[str, Any]:
    """The settings of a dataclass; raises ConfigError for an unknown one, which `+` can add."""
    allowed = [field.name for field in fields(kind)]
    for name in settings:
        if name not in allowed:
            raise ConfigError(unknown_message(f"{key}.{name}", allowed))
    return settings
