"""What `miho.analysis` offers without being asked for more than is used, and its two pages."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import miho
import miho.analysis
from miho.analysis import save_report, save_sweep_page
from miho.data import Dataset
from miho.identification import make_report
from miho.methods import LeastSquares
from miho.models.identified import read_parameters
from miho.optim import RandomSearch
from miho.study import Identity, Store, execute
from miho.testing import DecayFit
from miho.vehicle.models import Pacejka


def test_every_name_is_there_and_no_other() -> None:
    for name in miho.analysis.__all__:
        assert callable(getattr(miho.analysis, name))
    with pytest.raises(AttributeError, match="no attribute 'figures_of_speech'"):
        _ = miho.analysis.figures_of_speech  # type: ignore[attr-defined]


def test_importing_it_loads_no_figures() -> None:
    program = "import sys, miho.analysis; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout.split()
    assert "miho.analysis" in loaded
    assert not {"matplotlib", "seaborn", "jinja2"} & set(loaded)


def test_a_script_has_the_report_as_page_tables_and_parameters(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    alpha = np.linspace(-0.2, 0.2, 80)
    theta = np.array([[12.0, 1.6, 3000.0, 0.0, 0.0]])
    force = Pacejka().predict(theta, alpha)[0] + rng.normal(0, 20, alpha.size)
    data = Dataset("test rig", {"alpha": alpha, "Fy": force}, {"alpha": "rad", "Fy": "N"}, "Fy")
    space = miho.Space((
        miho.Parameter("B", "1/rad", 2, 40), miho.Parameter("C", "-", 1, 2.5),
        miho.Parameter("D", "N", 1e3, 9e3), miho.Parameter("Sx", "rad", -0.05, 0.05),
        miho.Parameter("Sy", "N", -500, 500),
    ))  # fmt: skip
    problem = miho.CurveFit(Pacejka(), data, space, compiled=False)
    record = miho.minimize(LeastSquares(), problem, miho.Budget(evaluations=2000), 0)
    assert record.theta is not None
    page = save_report(make_report(problem, record.theta), tmp_path / "report")
    html = page.read_text(encoding="utf-8")
    assert "Pacejka on test rig: error" in html
    assert "95 % intervals" in html
    identified = read_parameters(tmp_path / "report" / "parameters.json", Pacejka())
    assert identified.parameters["D"].low < 3000 < identified.parameters["D"].high
    assert identified.provenance["data"] == data.digest
    assert {path.suffix for path in page.parent.iterdir()} == {".csv", ".html", ".json", ".png"}


def test_a_script_has_the_page_of_all_runs(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="has no finished run"):
        save_sweep_page(tmp_path)
    environment = tmp_path / "runs"
    for seed in range(2):
        identity = Identity("decay", "random", seed, CONFIG, "c0de", "da7a")
        record = miho.minimize(RandomSearch(), DecayFit(), miho.Budget(evaluations=40), seed)
        execute(Store(environment), identity, lambda r=record: r, DecayFit.space, {"unit": "V"})
    html = save_sweep_page(environment).read_text(encoding="utf-8")
    assert "by miho.analysis.save_sweep_page" in html
    assert "random search" in html
    start = html.index('id="about">') + len('id="about">')
    about = json.loads(html[start : html.index("</script>", start)])
    assert about["problems"] == ["decay"]


CONFIG = {
    "model": {"_target_": "m"}, "dataset": {"_target_": "d"}, "loss": {"_target_": "l"},
    "space": {}, "optimizer": {}, "budget": {},
}  # fmt: skip
