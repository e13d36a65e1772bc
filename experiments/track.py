"""Track parameters that change while rows arrive: a stream of rows to a stream of states.

python -m experiments.track model=pacejka dataset=front_axle < log.jsonl   # JSON lines to states
python -m experiments.track dataset=front_axle stream=socket               # from a socket
python -m experiments.track stream=replay dataset=axle_log dataset.path=my.csv online.learn=20
python -m experiments.track stream=tire                                    # a tire with known truth
python -m experiments.track experiment=online_grip                         # trackers compared

Each line on stdin is an object with the model's inputs and output by column, in SI units, and
optionally "time"; each line on stdout is the state after it. In a terminal, the states are shown
in place. Ctrl-C keeps all states so far; online.resume=true continues from there.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

if not __package__:  # as python experiments/track.py, like python -m experiments.track
    sys.path[0] = str(Path(__file__).parents[1])

import numpy as np
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from baselines.online import Stream
from experiments.app.build import ConfigError, build_problem
from experiments.app.console import command
from experiments.app.instantiation import instantiate
from experiments.online.live import LiveView
from experiments.online.session import (
    EARLIER,
    STATE,
    STATES,
    Session,
    in_words,
    resumed,
)
from experiments.online.sources import Lines, Replay, Socket, Source, Synthetic
from miho.data import Dataset
from miho.fitting.search import searched
from miho.identification import CurveFit, Report
from miho.online import OnlineMethod, Running

SETTINGS = {
    "tracker": "the method: miho, or one of its peers",
    "stream": "the source of the rows: stdin, socket, replay, tire, car",
    "model, dataset, space": "the model, its offline data, and the box of the parameters",
    "online.learn": "time of the replayed data that is offline data [s]",
    "online.changes, .names": "parameters that may jump, by which share; their names in alarms",
    "online.input_noise": "standard deviations of the noise of inputs, such as '{alpha: 0.0005}'",
    "online.period": "time between rows without a column time [s]",
    "online.resume": "continue with the state that the last session left in root",
    "root": "folder of states, parameters, informative rows and page",
}


@dataclass(frozen=True)
class Task:
    """All that a method needs to start, and the source of its rows."""

    problems: Sequence[CurveFit]
    prior: Report | Mapping[str, tuple[float, float]]
    changes: Mapping[str, float] | None
    input_noise: Mapping[str, float]
    source: Source
    stream: Stream | None = None

    @property
    def columns(self) -> tuple[str, ...]:
        """Inputs and outputs of all problems."""
        names = [n for p in self.problems for n in (*p.model.inputs, p.dataset.output)]
        return tuple(dict.fromkeys(names))


def track(cfg: DictConfig) -> None:
    """Feed the method with all rows of the stream, then write what follows from its states."""
    several = HydraConfig.get().mode is RunMode.MULTIRUN
    root = Path(HydraConfig.get().runtime.output_dir if several else cfg.root)
    name = HydraConfig.get().runtime.choices.tracker
    task = task_of(cfg)
    method = instantiate(_node(cfg, "tracker"), "tracker", OnlineMethod)
    running = _begun(cfg, root, method, task)
    quiet = several or (cfg.online.live and sys.stdout.isatty())
    view = LiveView(sys.stdout) if quiet and not several else None
    words = {str(key): str(value) for key, value in cfg.online.names.items()}
    session = Session(running, task.columns, root, words, view, quiet)
    try:
        session.run(task.source)
    finally:
        from experiments.online.results import write_session  # slow: it draws

        said = [in_words(alarm, words) for alarm in session.alarms]
        if session.last is not None:
            if view is not None:
                view.show(session.last, said, last=True)
            title = f"Parameters tracked by {name}"
            paths = write_session(root, running, session.alarms, said, title)
            out = sys.stdout if quiet else sys.stderr
            for text in said:
                print(f"{name}, seed {cfg.seed}: {text}" if several else text, file=out)
            if not several:
                print("\n".join(map(str, paths)), file=out)
    if task.stream is not None:
        from experiments.online.comparison import compare, score  # slow: they draw

        score(root, name, cfg.seed, task.stream, session.alarms)
        if several:
            compare(Path(cfg.root))


def task_of(cfg: DictConfig) -> Task:
    """Return the problem, the prior and the source that a configuration describes."""
    node = _node(cfg, "stream")
    stated = {str(k): float(v) for k, v in cfg.online.changes.items()} or None
    noise = {str(k): float(v) for k, v in cfg.online.input_noise.items()}
    if "_target_" in node:
        stream = instantiate(node, "stream", Stream)
        return Task(
            stream.problem, stream.prior, stated or stream.changes,
            noise or stream.input_noise, Synthetic(stream), stream,
        )  # fmt: skip
    problem = build_problem(cfg)
    kind, later = node.get("source"), problem.dataset
    if kind == "replay" and cfg.online.learn is not None:
        problem, later = _split(problem, cfg.online.learn, cfg.online.period)
    sources = {
        "stdin": lambda: Lines(),
        "socket": lambda: Socket(node.get("host", "127.0.0.1"), node.get("port", 0)),
        "replay": lambda: Replay(later, cfg.online.period, node.get("rate")),
    }
    if kind not in sources:
        raise ConfigError(f"stream.source: is {kind!r}; expected {', '.join(sources)}")
    report = searched(problem, seed=cfg.seed).report()
    if problem.sigma is None:
        problem = replace(problem, sigma=report.at.noise)
    print(f"offline data: {len(problem.dataset):,} rows of {problem.dataset.name}", file=sys.stderr)
    return Task((problem,), report, stated, noise, sources[kind]())


def _split(problem: CurveFit, learn: float, period: float) -> tuple[CurveFit, Dataset]:
    """Return the problem on the rows before a time [s], and the data of the later rows."""
    data = problem.dataset
    times = data.columns.get("time", period * np.arange(len(data)))
    first = times - times[0] < learn
    if not 0 < np.count_nonzero(first) < len(data):
        raise ConfigError(
            f"online.learn: is {learn:g} s; expected less than the {times[-1] - times[0]:g} s of "
            f"{data.name}, and more than 0"
        )
    try:
        return replace(problem, dataset=data.select(first)), data.select(~first)
    except ValueError as error:
        raise ConfigError(f"online.learn: {error}") from None


def _begun(cfg: DictConfig, root: Path, method: OnlineMethod, task: Task) -> Running:
    """Return the run of the method, from the start or as the last session left it."""
    if cfg.online.resume:
        return resumed(root / STATE)
    if (root / STATES).exists():
        (root / STATES).replace(root / EARLIER)
    try:
        return method.start(
            task.problems, task.prior, task.changes, task.input_noise, cfg.online.period
        )
    except ValueError as error:
        raise ConfigError(f"online: {error}") from None


def _node(cfg: DictConfig, key: str) -> dict[str, object]:
    node = OmegaConf.to_container(cfg[key], resolve=True)
    if not isinstance(node, dict) or not node:
        raise ConfigError(f"{key}: is missing; choose one of conf/{key}/")
    return {str(name): value for name, value in node.items()}


def main() -> None:
    """Run the command."""
    command(track, config_name="online", settings=SETTINGS)


if __name__ == "__main__":
    main()
