"""Fig. 4, right, from a log of which one part was learned from."""

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.app.build import ConfigError, build
from experiments.app.compose import composed
from experiments.app.drawing import draw_axle
from experiments.app.execution import execution_of
from miho.vehicle.driving import Sensors, embedded_plant
from miho.vehicle.driving.proving_ground import perform, weaves
from tests.vehicle.driving.cars import car


@pytest.mark.slow
def test_the_rest_of_a_log_is_drawn_and_judged(tmp_path: Path) -> None:
    recording = perform(embedded_plant(car().vehicle), weaves()[0])
    log = recording.log("weave", Sensors(), np.random.default_rng(0))
    path, root = tmp_path / "weave.csv", tmp_path / "runs"
    pd.DataFrame(dict(log.channels)).to_csv(path, index=False)
    overrides = [f"dataset.path={path}", "optimizer=least_squares", f"root={root}"]
    whole = build(composed(["dataset=axle_log", *overrides]))
    part = build(composed(["dataset=axle_log", "dataset.end=12", *overrides]))
    execution_of(whole, quiet=True)
    with pytest.raises(ConfigError, match="no run of least_squares on an axle of a driving log"):
        draw_axle(root, tmp_path, "least_squares")
    execution_of(part, quiet=True)
    paths = draw_axle(root, tmp_path / "figures", "least_squares")
    assert [item.name for item in paths] == ["fig4_right.png", "fig4_right.pdf", "fig4_right.json"]
    about = json.loads(paths[-1].read_text(encoding="utf-8"))
    assert [item["data"] for item in about["runs"]] == [part.problem.dataset.digest]
    assert math.isclose(part.problem.dataset["vx"].mean(), 25.0, rel_tol=0.1)
