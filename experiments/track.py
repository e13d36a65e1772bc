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
from pathlib import Path

if not __package__:  # as python experiments/track.py, like python -m experiments.track
    sys.path[0] = str(Path(__file__).parents[1])

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from experiments.app.console import command
from experiments.online.live import LiveView
from experiments.online.session import Session, in_words
from experiments.online.task import begun, task_of

SETTINGS = {
    "tracker": "the method: miho, or one of its peers",
    "stream": "the source of the rows: stdin, socket, replay, tire, car",
    "model, dataset, space": "the model, its offline data, and the box of the parameters",
    "online.learn": "time of the replayed data that is offline data [s]",
    "online.changes, .names": "parameters that may jump, by which share; their names in alarms",
    "online.input_noise": "standard deviations of the noise of inputs, such as '{alpha: 0.0005}'",
    "online.period": "time between rows without a column time [s]",
    "online.resume": "continue after the rows of the last session in root",
    "root": "folder of states, parameters, informative rows and page",
}


def track(cfg: DictConfig) -> None:
    """Feed the method with all rows of the stream, then write the results."""
    several = HydraConfig.get().mode is RunMode.MULTIRUN
    root = Path(HydraConfig.get().runtime.output_dir if several else cfg.root)
    name = HydraConfig.get().runtime.choices["tracker"]
    task = task_of(cfg)
    running = begun(cfg, root, task)
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
            paths = write_session(root, running, session.alarms, said, title, task.units)
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


def main() -> None:
    """Run the command."""
    command(track, config_name="online", settings=SETTINGS)


if __name__ == "__main__":
    main()
