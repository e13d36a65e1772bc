"""The comparison of printed and corrected equations: its rows, on short drives."""

import math

import numpy as np
import pytest

from experiments.app.compose import composed
from experiments.check.printed_equations import VARIANTS, results, rows_of
from experiments.driving.car import known_car
from experiments.driving.outcome import Clearance
from experiments.driving.settings import driven, driver_of, track_and_vehicle

TRUTH = "drive.known=truth"


@pytest.mark.slow
def test_each_variant_drives_by_its_own_equations() -> None:
    """Through the swerve; with R = 1000 the regulator turns less at first than with R = 100."""
    settings = [TRUTH, "drive.start=350", "drive.distance=110", "drive.noise=false"]
    rows = {str(row["equations"]): row for row in rows_of("ims_obstacle", settings)}
    assert list(rows) == [variant.name for variant in VARIANTS]
    error, times = "largest e_y [m]", [row["time [s]"] for row in rows.values()]
    assert len(set(times)) > 1
    assert float(str(rows["printed"][error])) > float(str(rows["Eq. 10-12 printed"][error]))
    shares = {name: float(str(row["largest share of the plan's limit"]))
              for name, row in rows.items()}  # fmt: skip
    without_yaw = shares["Eq. 10-12 printed, Eq. 11 without yaw term"]
    assert shares["Eq. 10-12 printed"] > 1.3 * without_yaw, "Eq. 11 halves the limit"
    assert without_yaw > shares["corrected"], "the corrected plan brakes ahead"
    assert shares["corrected, R = 1000"] != shares["corrected"]
    assert shares["printed, R = 1000"] != shares["printed"]


def test_a_drive_off_the_road_counts_until_its_last_whole_lap() -> None:
    """Into the first corner of IMS at 216 km/h, on a road that gives 0.3 of what it should."""
    fast = [TRUTH, "drive.obstacle.sight=null", "drive.start=470", "drive.speed=60"]
    fast += ["drive.top_speed=60", "drive.road_friction=0.3", "drive.distance=150"]
    cfg = composed(["experiment=ims_obstacle", *fast])
    road, line, vehicle = track_and_vehicle(cfg)
    driver = driver_of(cfg, known_car(cfg, vehicle)[0], line)
    drive = driven(cfg, driver, road, line)
    row = results(cfg, drive, driver, Clearance.of(drive, road))
    assert 100 < float(str(row["left the road after [m]"])) < 150
    assert row["whole laps"] == 0
    largest = [value for name, value in row.items() if name.startswith(("largest", "lap", "time"))]
    assert len(largest) > 15
    assert np.isnan(np.array(largest, dtype=float)).all()
    whole = results(cfg, drive, driver, _inside(Clearance.of(drive, road)))
    assert math.isnan(float(str(whole["left the road after [m]"])))
    assert whole["largest e_y [m]"] == np.abs(drive["e_y"]).max()
    assert whole["time [s]"] == drive["time"][-1]


def _inside(clearance: Clearance) -> Clearance:
    """As if the road was wider by 20 m on either side."""
    return Clearance(clearance.rows, clearance.left + 20, clearance.right + 20)
