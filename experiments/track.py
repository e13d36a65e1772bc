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

import sys
from pathlib import Path

if not __package__:  # as python experiments/track.py, like python -m experiments.track
    sys.path[0] = str(Path(__file__).parents[1])

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from experiments.app.console import command
from experiments.online.follow import follow, follow_to_score
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
    "fresh": "a comparison replaces scores with other code, data, settings or packages",
    "root": "folder of states, parameters, informative rows and page",
}


def track(cfg: DictConfig) -> None:
    """Feed the method with all rows of the stream, then write the results."""
    several = HydraConfig.get().mode is RunMode.MULTIRUN
    root = Path(HydraConfig.get().runtime.output_dir if several else cfg.root)
    task = task_of(cfg)
    if task.stream is None:
        follow(cfg, root, task, begun(cfg, root, task))
    else:
        follow_to_score(cfg, root, task, task.stream)


def main() -> None:
    """Run the command."""
    command(track, config_name="online", settings=SETTINGS)


if __name__ == "__main__":
    main()
