"""Simulate the paper's field tests in closed loop, and draw their figures.

python -m experiments.drive experiment=ims_obstacle   # Fig. 7: around an obstacle, one minute
python -m experiments.drive experiment=lvms_laps      # Fig. 8: nine laps, 90 seconds
python -m experiments.drive -m experiment=ims_obstacle drive.performance_factor=0.5,0.7

If the car leaves the road, the drive is written and drawn as usual, and the exit code is 6.
"""

import sys
from pathlib import Path

if not __package__:  # as python experiments/drive.py, like python -m experiments.drive
    sys.path[0] = str(Path(__file__).parents[1])

from omegaconf import DictConfig
from tqdm import tqdm

from experiments.app.console import LEFT_ROAD, EndedError, command
from experiments.app.explain import BAD_SETTINGS, as_config_error
from experiments.driving.car import known_car
from experiments.driving.results import write_drive
from experiments.driving.settings import driven, driver_of, track_and_vehicle

SETTINGS = {
    "experiment": "ims_obstacle or lvms_laps, the field tests of the paper",
    "track, vehicle, controller": "the road, the car and its controller",
    "drive.known": "car parameters that planner and controllers use: identified or truth",
    "drive.equations": "corrected, printed, printed_plan or printed_steering",
    "drive.performance_factor": "share of the tires' grip that the plan uses (the paper's mu)",
    "drive.road_friction": "friction of the road, relative; the plan does not know it",
    "drive.top_speed, .distance": "[m/s] and [m]; --cfg job shows all settings of drive",
    "optimizer, seed": "the method that identifies the car; the seed of all measurement noise",
    "root": "folder of log, figure and table; with -m each drive has a subfolder",
}


def drive(cfg: DictConfig) -> None:
    """Write log, figure, table and provenance of one drive to the folder `drive.output`."""
    road, line, vehicle = track_and_vehicle(cfg)
    car, parts = known_car(cfg, vehicle)
    with as_config_error("drive", BAD_SETTINGS):
        driver = driver_of(cfg, car, line)
        distance = cfg.drive.distance
        with tqdm(total=distance, desc="drive", unit="m", leave=False, disable=None) as bar:
            simulated = driven(cfg, driver, road, line, lambda done: bar.update(done - bar.n))
    off_road = write_drive(cfg, simulated, driver, road, parts)
    if off_road is not None:
        advice = "lower drive.performance_factor or drive.top_speed"
        print(f"the car left the road {off_road}; {advice}", file=sys.stderr)
        raise EndedError(LEFT_ROAD)


if __name__ == "__main__":
    command(drive, config_name="drive", settings=SETTINGS)
