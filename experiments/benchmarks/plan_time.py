"""Time to plan a lap of LVMS; the bar is 50 ms on one thread.

python -m experiments.benchmarks.plan_time
"""

from __future__ import annotations

import sys
from time import perf_counter

import hydra
import numpy as np
from omegaconf import OmegaConf

from experiments.app.compose import CONF
from experiments.app.console import BUG, run_and_exit
from experiments.benchmarks.bars import machine
from miho.study import single_thread
from miho.vehicle.data.synthetic_brake import EMBEDDED_BRAKE
from miho.vehicle.driving.embedded import embedded_engine, embedded_tires
from miho.vehicle.driving.known_car import KnownCar
from miho.vehicle.driving.ovals import lvms
from miho.vehicle.driving.vehicle import Vehicle

BAR = 0.05
"""Seconds."""
TURNS = 30
CASES = ((1.0, 62.0), (1.0, 90.0), (0.5, 90.0))
"""Performance factors and top speeds [m/s]; with the last the car has to brake."""


def main() -> None:
    """Print the median and the best of 30 plans of each case, and whether the bar is met."""
    with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
        settings = OmegaConf.to_container(hydra.compose("vehicle/av21_full").vehicle)
    vehicle = Vehicle.from_settings(settings)  # type: ignore[arg-type]
    car = KnownCar.of_tires(vehicle, embedded_tires(), embedded_engine(), EMBEDDED_BRAKE)
    line = lvms()
    met = True
    with single_thread():
        for mu, top_speed in CASES:
            planner = car.planner(mu, top_speed)
            planner.plan(line)  # compilation is not measured
            seconds = []
            for _ in range(TURNS):
                start = perf_counter()
                plan = planner.plan(line)
                seconds.append(perf_counter() - start)
            median = float(np.median(seconds))
            met = met and median <= BAR
            times = f"median {1e3 * median:.1f} ms, best {1e3 * min(seconds):.1f} ms"
            print(
                f"mu {mu:g}, top speed {top_speed:g} m/s, {line.s.size} points: {times}; lap of "
                f"{plan.lap_time:.2f} s"
            )
    print(f"bar of {1e3 * BAR:g} ms: {'met' if met else 'missed'}\n{machine()}")
    if not met:
        sys.exit(BUG)


if __name__ == "__main__":
    run_and_exit(main)
