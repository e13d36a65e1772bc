"""Joint problems as a configuration and on the command line, as the manual shows them."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from experiments.app.build import ConfigError, build, rebuild
from experiments.app.compose import composed
from experiments.app.configured import as_configured
from experiments.app.execution import execution_of
from experiments.app.optimum import report_of
from experiments.app.plan import experiment_of, requests
from miho.models.layout import PART
from miho.study import load_runs

PAGE = Path(__file__).parents[2] / "docs" / "joint.md"
AXLE = "experiment=front_axle_tires"
t = np.linspace(0, 2, 40)


def own_options() -> str:
    """The folder of options that the manual's example makes, as --config-dir names it."""
    return f"hydra.searchpath=[file://{Path('my_options').absolute()}]"


def decay(a: float, b: float) -> np.ndarray:
    return np.asarray(a * np.exp(-b * t))


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """The files of the manual's configuration in a folder, and its option two_decays; (2, 40)."""
    monkeypatch.chdir(tmp_path)
    noise = np.random.default_rng(3).standard_normal((2, t.size))
    values = np.stack([decay(2.0, 1.5) + 0.05 * noise[0], decay(6.0, 1.5) + 0.5 * noise[1]])
    for name, column in zip(("first", "second"), values, strict=True):
        rows = "\n".join(f"{a!r},{b!r}" for a, b in zip(t.tolist(), column.tolist(), strict=True))
        Path(f"{name}.csv").write_text(f"t,y\n{rows}\n")
    Path("decay.py").write_text(
        "import numpy as np\n\n\ndef decay(t: 's', *, a: 'V', b: '1/s') -> 'V':\n"
        "    return a * np.exp(-b * t)\n"
    )
    folder = Path("my_options/experiment")
    folder.mkdir(parents=True)
    (settings,) = re.findall(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    (folder / "two_decays.yaml").write_text(settings)
    return values


def by_hand(values: np.ndarray, sigma: tuple[float, float]) -> np.ndarray:
    """SciPy's least squares of the weighted residuals of both, below each other: a, b, a."""

    def residuals(theta: np.ndarray) -> np.ndarray:
        both = decay(theta[0], theta[1]), decay(theta[2], theta[1])
        return np.concatenate([(m - y) / s for m, y, s in zip(both, values, sigma, strict=True)])

    return np.asarray(least_squares(residuals, [1.0, 1.0, 1.0], xtol=1e-15, ftol=1e-15).x)


def test_the_manuals_configuration_is_what_scipy_finds(data: np.ndarray) -> None:
    """One sigma is given and one estimated; a stored run is rebuilt with it, and reported."""
    cfg = composed([own_options(), "experiment=two_decays", "root=runs", "budget.seconds=60"])
    (request,) = requests(cfg, "", [0])
    assert request.own_code
    experiment = build(cfg)
    assert experiment.identity.code == request.identity.code
    assert experiment.identity.config == request.identity.config
    parts = experiment.identity.config["problem"]["parts"]
    assert parts["second"]["sigma"] == 0.5
    stored = execution_of(experiment, quiet=True).run
    assert stored is not None
    theta = np.array(stored.result["theta"])
    sigma = parts["first"]["sigma"]
    assert sigma == pytest.approx(0.05, rel=0.35)  # three standard errors of 40 rows
    best = by_hand(data, (sigma, 0.5))
    np.testing.assert_allclose(theta, best, rtol=1e-6)
    squares = np.mean((decay(*best[:2]) - data[0]) ** 2)
    assert sigma == pytest.approx(np.sqrt(squares / (1 - 3 / 80)), rel=1e-3)
    with pytest.raises(ConfigError, match=r"code in decay\.py; add --trust"):
        rebuild(stored)
    report = report_of(rebuild(stored, trusted=True), stored)
    assert report.parameters["parameter"].tolist() == ["a_first", "b", "a_second"]
    runs = as_configured(load_runs(Path("runs")).runs)
    assert runs["problem"].tolist() == ["first-second-joint"]
    # A file of the model's that changes makes another run of it.
    Path("decay.py").write_text(Path("decay.py").read_text() + "\n\nOTHER = 1\n")
    assert build(cfg).identity.code != experiment.identity.code


def test_a_sweep_shares_what_its_seeds_share(data: np.ndarray) -> None:
    cfg = composed([own_options(), "experiment=two_decays", "problem.parts.first.sigma=0.05"])
    first, second = requests(cfg, "", [0, 1])
    assert first.setting == second.setting
    problem = experiment_of(first.setting).problem
    assert problem.sigma_known
    np.testing.assert_array_equal(np.unique(problem.dataset["sigma of the row"]), [0.05, 0.5])


def test_two_outputs_of_one_file_in_two_units(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Place and speed of a swing, whose model gives both, beside SciPy's."""
    monkeypatch.chdir(tmp_path)
    Path("swing.py").write_text(
        "import numpy as np\n\n\ndef place(t: 's', *, a: 'm', w: 'rad/s') -> 'm':\n"
        "    return a * np.sin(w * t)\n\n\ndef speed(t: 's', *, a: 'm', w: 'rad/s') -> 'm/s':\n"
        "    return a * w * np.cos(w * t)\n"
    )
    noise = np.random.default_rng(0).standard_normal((2, t.size))
    x = 0.3 * np.sin(4 * t) + 0.01 * noise[0]
    v = 1.2 * np.cos(4 * t) + 0.1 * noise[1]
    lines = (",".join(map(repr, row)) for row in np.stack([t, x, v], axis=1).tolist())
    Path("swing.csv").write_text("\n".join(["t,x,v", *lines]) + "\n")
    overrides = [
        "model=function", "model.path=swing.py", "dataset=csv", "dataset.path=swing.csv",
        "dataset.columns=[t,x,v]", "dataset.units=[s,m,m/s]",
        "space={a: {unit: m, low: 0, high: 1}, w: {unit: rad/s, low: 1, high: 9}}",
        "problem.parts.x.dataset.output=x", "problem.parts.x.model.function=place",
        "problem.parts.v.dataset.output=v", "problem.parts.v.model.function=speed",
        "problem.parts.x.sigma=0.01", "problem.parts.v.sigma=0.1",
    ]  # fmt: skip
    stored = execution_of(build(composed([*overrides, "root=runs"])), quiet=True).run
    assert stored is not None

    def residuals(theta: np.ndarray) -> np.ndarray:
        a, w = theta
        place, speed = a * np.sin(w * t), a * w * np.cos(w * t)
        return np.concatenate([(place - x) / 0.01, (speed - v) / 0.1])

    best = least_squares(residuals, [0.3, 4.0], xtol=1e-15, ftol=1e-15).x
    np.testing.assert_allclose(stored.result["theta"], best, rtol=1e-6)
    with pytest.raises(ConfigError, match="v: column 'v' has unit 'm/s'; expected 'm'"):
        build(composed([*overrides, "problem.parts.v.model.function=place"]))


def test_the_tires_of_the_front_axle_are_two_parts_of_one_problem() -> None:
    """On the command line as in YAML, where parts, settings and parameters can be added."""
    sigma = ["problem.parts.left.sigma=390", "problem.parts.right.sigma=540"]
    written = build(composed([AXLE, *sigma]))
    typed = build(
        composed(
            ["dataset=tire_lf", "space=axle_wide", "problem.name=front_axle_tires",
             "problem.parts={left: {dataset: {tire: lf}}, right: {dataset: {tire: rf}}}",
             "problem.local=[D,Sx,Sy]", *sigma]
        )
    )  # fmt: skip
    assert typed.identity.id == written.identity.id
    names = ("B", "C", "D_left", "Sx_left", "Sy_left", "D_right", "Sx_right", "Sy_right")
    assert written.problem.space.names == names
    third = composed(
        [AXLE, "problem.sigma=400", "problem.parts.rear={dataset: {tire: lr, n: 50}}",
         "problem.parts.left.dataset.n=100", "+space.D_rear={low: 500, sigma_max: 20}",
         "+space.D_left.fixed=4000", "+space.D_right.tied='1.4 * D_left + 0 * D_rear'"]
    )  # fmt: skip
    problem = build(third).problem
    assert np.bincount(problem.dataset[PART].astype(int)).tolist() == [100, 3000, 50]
    (rear,) = (p for p in problem.space.parameters if p.name == "D_rear")
    assert (rear.low, rear.high, rear.sigma_max, rear.unit) == (500.0, 20000.0, 20.0, "N")
    assert not {"D_left", "D_right"} & set(problem.space.names)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["problem.parts.left.sigma=-1"], "problem.parts: left: sigma is -1 in row 1; expected"),
        (["problem.parts.left.sigma=x"], "dataset tire_lf: no column 'x'"),
        (["problem.parts.left.sigma=alpha"], "left: sigma 'alpha' has the unit 'rad'; expected"),
        (["problem.parts.left.sigma=[1]"], r"left: sigma is \[1\]; expected a number"),
        (["problem.local=[Q]"], "local: Q is not a parameter of any part"),
        (["~problem.parts.left"], "parts: expected at least two, got 1"),
        (["~space.D"], "D_left has no bounds"),
        (["+space.D_middle.fixed=1"], r"space\.D_middle\.unit: is missing"),
        (["problem.parts.left.dataset.m=3"], r"problem\.parts\.left\.dataset\.m: is unknown"),
        (["problem.parts.left.foo=3"], r"parts\.left\.foo: is unknown; allowed are dataset, model"),
        (["problem.parts.left.dataset.n=4"], "left: 4 rows for 5 parameters do not determine"),
        (["loss=huber", "loss.scale=400"], "left: lacks sigma, which a robust loss needs"),
        (
            ["problem.parts.left.model={_target_: os.system}"],
            r"parts\.left\.model\._target_: 'os\.system' is not a class",
        ),
        (
            [
                "problem.parts.T={dataset: {_target_: miho.vehicle.data.load_engine_drive, "
                "throttle: 0.2}}"
            ],
            "dataset torque_20: no column 'alpha'",
        ),
    ],
)
def test_bad_parts_get_one_line(overrides: list[str], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        build(composed([AXLE, *overrides]))
    assert "\n" not in str(caught.value)
