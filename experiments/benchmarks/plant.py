"""Speed and accuracy of the plant, and the time to plan a lap.

python -m experiments.benchmarks.plant [--quick] [--output FOLDER]

Speed is simulated seconds per second of one thread, at a step of 1 ms, in control periods of 10 ms,
as in a closed loop, and of 100 ms. The two alternate, and the fastest of many short turns counts.
Accuracy is the change with half the step in a lap of IMS in closed loop, with braking before the
turns. Plans are of a lap of LVMS; the median of 30 counts.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
import pandas as pd

from experiments.app.front_axle import car_of_paper
from experiments.benchmarks.bars import Measured, at_least, at_most, benchmark, interleaved, turns
from miho.vehicle.data.synthetic_brake import EMBEDDED_BRAKE
from miho.vehicle.driving import Command, Driver, KnownCar, Vehicle, ims, lvms, road_of, simulate
from miho.vehicle.driving.double_track import DoubleTrack
from miho.vehicle.driving.embedded import embedded_engine, embedded_plant, embedded_tires
from miho.vehicle.driving.path_tracking import Weights

PERIOD = 0.01
CRUISE = Command(0.005, 0.3, 0.0, 4)
PLANS = 30
CASES = ((1.0, 62.0), (1.0, 90.0), (0.5, 90.0))
"""Performance factors and top speeds [m/s] of plans; with the last the car has to brake."""


def held(car: DoubleTrack, command: Command, period: float, count: int) -> Callable[[], object]:
    """Job of `count` periods under one command, always from the same start."""
    start = car.start(speed=40.0, gear=4)

    def run() -> None:
        state = start
        for _ in range(count):
            state = car.advance(state, command, period)
            car.motion(state)

    return run


def speeds(car: DoubleTrack, quick: bool) -> pd.DataFrame:
    """Simulated seconds per second."""
    jobs = {"10 ms": held(car, CRUISE, PERIOD, 10), "100 ms": held(car, CRUISE, 10 * PERIOD, 1)}
    # Turns are short, so that other programs do not interrupt all of them.
    took = interleaved(jobs, 50 if quick else 500, 1e-4)
    rows = [
        {
            "period": name,
            "times real time": 10 * PERIOD / seconds,
            "us per step": 1e3 * seconds / (10 * PERIOD),
        }
        for name, seconds in took.items()
    ]
    return pd.DataFrame(rows)


def lap_time(vehicle: Vehicle, step: float) -> float:
    """Seconds of the second lap of IMS, planned and driven with the true parameters of the car."""
    line = ims()
    car = embedded_plant(vehicle, road_of(line), step)
    known_car = KnownCar.of_tires(vehicle, car.tires, car.engine, car.brake)
    plan = known_car.planner(mu=0.6, top_speed=85.0).plan(line)
    driver = Driver(
        plan, known_car.speed_controller(), known_car.steering_controller(Weights(steering=100.0))
    )
    start = car.start(speed=float(plan.v[0]), gear=6)
    log = simulate(car, driver, start, 2.01 * line.length)
    if log.stopped:
        raise RuntimeError(f"the lap of IMS ended early: {log.stopped}")
    first, second = np.interp([line.length, 2 * line.length], log["distance"], log["time"])
    return float(second - first)


def plans(vehicle: Vehicle) -> pd.DataFrame:
    """Milliseconds of a plan, a row per case."""
    car = KnownCar.of_tires(vehicle, embedded_tires(), embedded_engine(), EMBEDDED_BRAKE)
    line, rows = lvms(), []
    for mu, top_speed in CASES:
        plan = partial(car.planner(mu, top_speed).plan, line)
        lap_time = plan().lap_time  # compilation is not measured
        seconds = turns({"plan": plan}, PLANS)["plan"]
        row = {"mu": mu, "top speed [m/s]": top_speed, "points": line.s.size}
        rows.append({**row, "lap [s]": lap_time, "plan [ms]": 1e3 * float(np.median(seconds))})
    return pd.DataFrame(rows)


def measure(quick: bool) -> Measured:
    """Measure speed, accuracy and plans."""
    vehicle = car_of_paper()
    car = embedded_plant(vehicle)
    fast, planned = speeds(car, quick), plans(vehicle)
    laps = [lap_time(vehicle, step) for step in (1e-3, 5e-4)]
    bars = [
        at_least("real time factor", float(fast["times real time"].iloc[0]), 50.0),
        at_most("half the step: lap time, relative", abs(laps[1] / laps[0] - 1), 1e-4),
        at_most("a plan of LVMS", float(planned["plan [ms]"].max()), 50.0, "ms"),
    ]
    notes = [
        f"lap of IMS in closed loop: {laps[0]:.6f} s, half the step {laps[1]:.6f} s\n",
        planned.to_string(index=False, float_format="{:.4g}".format),
    ]
    return Measured(fast, fast, bars, notes)


if __name__ == "__main__":
    benchmark(__doc__, measure, "plant")
