"""All that a session needs, from a configuration: problem, prior, method and source."""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import DictConfig, OmegaConf

from baselines.online import Stream
from experiments.app.build import ConfigError, build_problem
from experiments.app.explain import as_config_error
from experiments.app.instantiation import instantiate
from experiments.online.session import ROWS, STATES, repair, replay
from experiments.online.sources import Lines, Replay, Socket, Source, Synthetic
from miho.fitting.search import searched
from miho.identification import CurveFit, Report
from miho.online import OnlineMethod, Running
from miho.online.method import Problems
from miho.online.motion import StepRows, is_motion, measured_motion
from miho.online.outputs import TIME, noise_of_rows, problem_of
from miho.quantities import Array


@dataclass(frozen=True)
class Task:
    """All that a method needs to start, and the source of its rows."""

    problem: Problems
    prior: Report | Mapping[str, tuple[float, float]]
    changes: Mapping[str, float] | None
    input_noise: Mapping[str, float] | None
    source: Source
    stream: Stream | None = None
    steps: StepRows | None = None

    @property
    def units(self) -> dict[str, str]:
        """Unit of each parameter."""
        return {p.name: p.unit for problem in self._each for p in problem.space.parameters}

    @property
    def columns(self) -> tuple[str, ...]:
        """Inputs and outputs of all problems; states and inputs of a differential equation."""
        if self.steps is not None:
            return self.steps.names
        names = [n for p in self._each for n in (*p.model.inputs, p.dataset.output)]
        return tuple(dict.fromkeys(names))

    @property
    def _each(self) -> Sequence[CurveFit]:
        return [self.problem] if isinstance(self.problem, CurveFit) else self.problem


def task_of(cfg: DictConfig) -> Task:
    """Return the problem, the prior and the source that a configuration describes."""
    node = _node(cfg, "stream")
    stated = {str(k): float(v) for k, v in cfg.online.changes.items()} or None
    noise = {str(k): float(v) for k, v in cfg.online.input_noise.items()} or None
    if "_target_" in node:
        stream = instantiate(node, "stream", Stream)
        return Task(
            stream.problem, stream.prior, stated or stream.changes,
            noise or stream.input_noise, Synthetic(stream), stream,
        )  # fmt: skip
    problem = later = build_problem(cfg)
    steps, kind = _steps(problem), node.get("source")
    clock = TIME if steps is None else steps.time
    if kind == "replay" and clock not in problem.dataset.columns:
        print(
            f"{problem.dataset.name} has no column {clock!r}: its rows are replayed as "
            f"{cfg.online.period:g} s apart (online.period)",
            file=sys.stderr,
        )
    if kind == "replay" and cfg.online.learn is not None:
        problem, later = _split(problem, clock, cfg.online.learn, cfg.online.period)
    sources: dict[str, Callable[[], Source]] = {
        "stdin": Lines,
        "socket": lambda: Socket(node.get("host", "127.0.0.1"), node.get("port", 0)),
        "replay": lambda: Replay(_rows(later, steps), cfg.online.period, node.get("rate")),
    }
    if kind not in sources:
        raise ConfigError(f"stream.source: is {kind!r}; expected {', '.join(sources)}")
    report = searched(problem, seed=cfg.seed).report()
    sigma = problem_of(report).sigma
    problem = replace(problem, sigma=noise_of_rows(report.at) if sigma is None else sigma)
    print(f"offline data: {len(problem.dataset):,} rows of {problem.dataset.name}", file=sys.stderr)
    if report.at.dependence is not None:
        print(
            "errors of neighbouring rows are correlated: a row counts as one with "
            f"{noise_of_rows(report.at) / report.at.noise:.1f} times the noise",
            file=sys.stderr,
        )
    with as_config_error():
        return Task(problem, report, stated, noise, sources[kind](), None, steps)


def _steps(problem: CurveFit) -> StepRows | None:
    """The steps between rows of a differential equation; None for another model."""
    with as_config_error():
        return StepRows.of_problem(problem) if is_motion(problem) else None


def _rows(problem: CurveFit, steps: StepRows | None) -> Mapping[str, Array]:
    """The measurements of a problem by column, one row for each time of a differential equation."""
    if steps is None:
        return problem.dataset.columns
    columns = measured_motion(problem)
    return {TIME: columns.pop(steps.time), **columns}


def _split(problem: CurveFit, clock: str, learn: float, period: float) -> tuple[CurveFit, CurveFit]:
    """Return the problem on the rows before a time [s], and on the later rows."""
    data = problem.dataset
    times = data.columns.get(clock, period * np.arange(len(data)))
    times = times - times.min()
    first = times < learn
    if not 0 < np.count_nonzero(first) < len(data):
        raise ConfigError(
            f"online.learn: is {learn:g} s; expected less than the {times.max():g} s of "
            f"{data.name}, and more than 0"
        )
    with as_config_error("online.learn"):
        earlier, later = (replace(problem, dataset=data.select(rows)) for rows in (first, ~first))
        return earlier, later


def method_of(cfg: DictConfig) -> OnlineMethod:
    """Return the method that a configuration describes."""
    return instantiate(_node(cfg, "tracker"), "tracker", OnlineMethod)


def request_of(cfg: DictConfig) -> dict[str, Any]:
    """Return the settings on which the states of a synthetic stream depend, except the seed."""
    online = {name: cfg.online[name] for name in ("changes", "input_noise", "period")}
    nodes = {"tracker": _node(cfg, "tracker"), "stream": _node(cfg, "stream") | {"seed": None}}
    return nodes | {"online": OmegaConf.to_container(OmegaConf.create(online))}


def begun(cfg: DictConfig, root: Path, task: Task) -> Running:
    """Return the run of the method, from the start or after the rows of the last session.

    Without `online.resume` the files of an earlier session are kept under other names.
    """
    method = method_of(cfg)
    earlier = [path for path in (root / STATES, root / ROWS) if path.exists()]
    if cfg.online.resume and root / ROWS not in earlier:
        raise ConfigError(f"online.resume: {root / ROWS} is missing; expected it of a session")
    with as_config_error("online"):
        running = method.start(
            task.problem, task.prior, task.changes, task.input_noise, cfg.online.period
        )
        if cfg.online.resume:
            for path in earlier:
                repair(path)
            replay(running, root / ROWS)
            return running
        for path in earlier:
            path.replace(path.with_stem(f"{path.stem}.earlier"))
        return running


def _node(cfg: DictConfig, key: str) -> dict[str, Any]:
    node = OmegaConf.to_container(cfg[key], resolve=True)
    if not isinstance(node, dict) or not node:
        raise ConfigError(f"{key}: is missing; choose one of conf/{key}/")
    return {str(name): value for name, value in node.items()}
