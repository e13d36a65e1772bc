"""Every YAML composes, and what it describes can be built and run."""

import hashlib
import json
import math
from collections import Counter
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from omegaconf import OmegaConf

from baselines.problems import published_fit, published_names
from baselines.problems.posed import posed_problem
from experiments.app.build import ConfigError, build, build_optimizer, build_problem, plain
from experiments.app.comparing import chosen_method, chosen_problems
from experiments.app.compose import composed
from experiments.app.options import options_of, recorded, settings_of
from miho.identification import linear_optimum
from miho.methods.least_squares import LeastSquares
from miho.optim import Budget, minimize

CONF = Path(__file__).parent.parent / "conf"
NEEDS_A_SETTING = {
    "axle_log", "brake_log", "csv", "mat", "published", "tir", "torque_log", "zero_residuals"
}  # fmt: skip
NEEDS_A_LIBRARY = {"ngopt": "nevergrad", "dehb": "dehb", "dfo_ls": "dfols"}
DRIVEN = {"front_axle", "front_axle_drive", "front_axle_tires", "lively_drive", "steering_test"}
"""Their data are simulated by a car that takes seconds to compile."""
SWEPT = "hydra.sweeper.params.optimizer"


def text(dataset: str) -> str:
    return (CONF / "dataset" / f"{dataset}.yaml").read_text(encoding="utf-8")


def options(group: str) -> list[str]:
    return [name for name in options_of(group) if "/" not in name]


def slow_drives(names: list[str]) -> list[Any]:
    return [
        pytest.param(name, marks=pytest.mark.slow) if name in DRIVEN else name for name in names
    ]


def in_folders(group: str) -> list[str]:
    return [name for name in options_of(group) if "/" in name]


def test_the_groups_are_known() -> None:
    groups = {path.name for path in CONF.iterdir() if path.is_dir()}
    assert groups == {
        "model", "dataset", "space", "loss", "problem", "optimizer", "budget", "experiment",
        "vehicle", "tracking", "hydra", "track", "controller", "tracker", "stream",
    }  # fmt: skip


@pytest.mark.parametrize("optimizer", options("optimizer"))
def test_optimizers(optimizer: str) -> None:
    if optimizer in NEEDS_A_LIBRARY:
        pytest.importorskip(NEEDS_A_LIBRARY[optimizer])
    experiment = build(composed([f"optimizer={optimizer}"]))
    assert experiment.identity.optimizer == optimizer


@pytest.mark.parametrize(
    "option",
    [
        pytest.param(option, marks=[pytest.mark.slow] * (option != "r500/miho"))
        for option in in_folders("optimizer")
    ],
)
def test_an_option_in_a_folder_is_its_method_with_other_settings(option: str) -> None:
    identity = build(composed([f"optimizer={option}"])).identity
    assert identity.optimizer == option.rpartition("/")[2]


def test_a_method_can_be_named() -> None:
    assert build(composed(["optimizer=miho", "method=mine"])).identity.optimizer == "mine"
    with pytest.raises(ConfigError, match="write optimizer=pso_100 to choose a method"):
        composed(["optimizer=miho", "method=pso_100"])
    unnamed = plain(composed(["optimizer=pso_500"])) | {"method": None}
    assert build(unnamed).identity.optimizer == "pso", "the class names it"


@pytest.mark.parametrize(
    ("optimizer", "distribution"),
    [("cma_es", "cmaes"), ("dehb", "dehb"), ("dfo_ls", "DFO-LS"), ("tiktak", None)],
)
def test_a_run_records_the_version_of_its_library(optimizer: str, distribution: str | None) -> None:
    if optimizer in NEEDS_A_LIBRARY:
        pytest.importorskip(NEEDS_A_LIBRARY[optimizer])
    packages = build(composed([f"optimizer={optimizer}"])).identity.packages
    assert set(packages) - {"numpy", "scipy"} == ({distribution} if distribution else set())


@pytest.mark.parametrize(
    "dataset", slow_drives([name for name in options("dataset") if name not in NEEDS_A_SETTING])
)
def test_datasets(
    dataset: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    if dataset.startswith("seong"):
        monkeypatch.setenv("MIHO_DATA_DIR", str(request.getfixturevalue("reference_data")))
    experiment = build(composed([f"dataset={dataset}", "optimizer=random"]))
    assert experiment.problem.dataset.name == dataset
    if dataset.startswith(("seong", "tire")):
        assert len(experiment.problem.dataset) == (300 if dataset.startswith("seong") else 3000)
    record = minimize(experiment.optimizer, experiment.problem, Budget(evaluations=50))
    assert record.theta is not None


def test_a_file_of_your_own(tmp_path: Path) -> None:
    path = tmp_path / "mine.csv"
    path.write_text("alpha,Fy\n" + "\n".join(f"{i / 100},{-i}" for i in range(20)))
    experiment = build(composed(["dataset=csv", f"dataset.path={path}"]))
    assert len(experiment.problem.dataset) == 20
    tire = CONF.parent / "miho" / "vehicle" / "data" / "tires" / "lf.tir"
    overrides = ["dataset=tir", f"dataset.tire={tire}", "dataset.ranges.alpha=[0, 0.1]"]
    assert build(composed(overrides)).problem.dataset["alpha"].min() >= 0


def own_data(tmp_path: Path, force: float, unit: str = "N") -> str:
    """A tire whose largest force is `force` [N], in a file."""
    alpha = np.linspace(-0.2, 0.15, 60)
    Fy = -force * np.sin(1.4 * np.arctan(12 * alpha))
    path = tmp_path / "mine.csv"
    rows = zip(alpha, Fy / {"N": 1.0, "kN": 1e3}[unit], strict=True)
    path.write_text("alpha,Fy\n" + "\n".join(f"{a},{F}" for a, F in rows))
    return str(path)


@pytest.mark.parametrize(("force", "unit"), [(300.0, "N"), (5000.0, "kN"), (40e3, "N")])
def test_the_box_of_own_data_is_scaled_by_them(tmp_path: Path, force: float, unit: str) -> None:
    path = own_data(tmp_path, force, unit)
    overrides = ["dataset=csv", f"dataset.path={path}", f"dataset.units=[rad,{unit}]"]
    experiment = build(composed(overrides))
    D, Sx, Sy = experiment.problem.space.parameters[2:]
    np.testing.assert_allclose((D.low, D.high, D.sigma_max), force * np.array([0.2, 3, 0.07]), 1e-3)
    np.testing.assert_allclose((Sx.low, Sx.high), (-0.1, 0.1))
    np.testing.assert_allclose((Sy.low, Sy.high), (-force / 2, force / 2), 1e-3)
    assert experiment.identity.config["space"]["D"] == {
        "unit": "N", "low": D.low, "high": D.high, "scale": "linear", "mean": None, "std": None,
        "sigma_max": D.sigma_max, "sigma_min": 0.0,
    }  # fmt: skip
    narrower = build(composed([*overrides, "space.D.low=0", f"space.D.high={2 * force}"]))
    assert narrower.problem.space.parameters[2].low == 0.0
    assert narrower.problem.space.parameters[2].high == 2 * force
    for seed in range(3):
        record = minimize(LeastSquares(), experiment.problem, Budget(evaluations=3000), seed)
        np.testing.assert_allclose(record.theta, (12, 1.4, force, 0, 0), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("space.D.scaled.by=Fz", r"space\.D\.scaled\.by: is 'Fz'; choose from output, alpha, Fy"),
        (
            "space.D.scaled.high=much",
            r"space\.D\.scaled\.high: is 'much'; expected numbers for low",
        ),
        ("+space.D.scaled.unit=5", r"space\.D\.scaled\.unit: is 5; expected numbers for low"),
        ("space.D.scaled.high=0.1", r"space: parameter 'D': low is .* expected finite bounds"),
    ],
)
def test_a_scale_that_is_none(tmp_path: Path, override: str, message: str) -> None:
    path = own_data(tmp_path, 3000.0)
    with pytest.raises(ConfigError, match=message):
        build(composed(["dataset=csv", f"dataset.path={path}", override]))


@pytest.mark.parametrize("space", options("space"))
def test_spaces(space: str) -> None:
    """Each space belongs to the model of the same name, or to the tire model."""
    model = space.removesuffix("_scaled")
    model = model if model in options("model") else "pacejka"
    needs = [name for name in options("dataset") if f"/space: {space}\n" in text(name)]
    overrides = [f"model={model}", f"space={space}"]
    ready = [name for name in needs if name not in NEEDS_A_SETTING and not name.startswith("seong")]
    experiment = build(composed([*(f"dataset={name}" for name in ready[:1]), *overrides]))
    assert experiment.problem.space.names == tuple(experiment.problem.model.parameters)


SETS = [name for name in recorded() if name.startswith(("mw_", "cr_"))]
PUBLISHED = {name: posed_problem(name) for name in recorded() if name not in SETS}
QUICK = {"nist_nelson_log", "mw_bdqrtic_8"}
"""Published problems that stand for all, of which many would take minutes."""


def test_published_problems_stay_as_they_are() -> None:
    """Their rule gives the boxes of all stored runs; fourteen digits are the same everywhere."""
    nodes = json.dumps([settings_of(name) for name in sorted(recorded())])
    digest = hashlib.sha256(nodes.encode()).hexdigest()
    assert digest == "fb64837beb9126c6e90bc8515161c5c40c42e7912356b36d4072438f8d0b4d87"


def test_the_error_of_a_published_fit_is_its_published_sum_of_squares() -> None:
    for name, posed in PUBLISHED.items():
        error = math.sqrt(published_fit(posed.dataset.name).squares / len(posed.dataset))
        assert recorded()[name][0] == float(f"{error:.14g}"), name


def test_every_published_problem_is_posed_in_two_boxes() -> None:
    boxes = Counter(posed.dataset.name for posed in PUBLISHED.values())
    assert boxes == dict.fromkeys(published_names(), 2)
    for name, posed in PUBLISHED.items():
        optimum = published_fit(posed.dataset.name).optimum
        ranges = zip(posed.ranges.values(), optimum, strict=True)
        assert all(low < value < high for (low, high, _), value in ranges), name


@pytest.mark.parametrize(
    "problem",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name in recorded().keys() - QUICK))
        for name in options("problem")
    ],
)
def test_problems(
    problem: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each has its file's name, and no run beats its recorded optimum."""
    if problem.startswith("sample"):
        monkeypatch.setenv("MIHO_DATA_DIR", str(request.getfixturevalue("reference_data")))
    cfg = composed([f"problem={problem}"])
    experiment = build(cfg)
    assert experiment.problem.name == experiment.identity.problem == problem
    assert cfg.problem.evidence
    optimum = experiment.facts["optimum"]
    record = minimize(LeastSquares(screen=200, starts=1, rounds=1), experiment.problem)
    assert max(record.loss, (cfg.problem.resolution or 0.0) ** 2) > optimum * (1 - 2e-9)


def test_another_problem_has_no_recorded_optimum() -> None:
    same = composed(["problem=torque_05", "experiment=compare", "dataset.seed=0"])
    assert same.problem.optimum == composed(["problem=torque_05"]).problem.optimum > 0
    assert same.model._target_.endswith("TorqueCubic")
    for other in ("dataset.n=300", "space.B.high=30", "loss=huber", "problem.sigma=400"):
        assert composed(["problem=tire_lf", other]).problem.optimum is None, other
    assert composed(["problem=tire_lf", "dataset.n=300", "problem.optimum=9"]).problem.optimum == 9
    with pytest.raises(ConfigError, match=r"is about dataset=tire_lf, but .* dataset=tire_rf"):
        composed(["problem=tire_lf", "dataset=tire_rf"])


def test_the_known_optimum_of_exact_data_is_their_resolution() -> None:
    """A loss of zero is none that a method could come near by a factor."""
    cfg = composed(["problem=mgh_gulf_starts"])
    assert cfg.problem.optimum == 0
    assert build(cfg).facts["optimum"] == cfg.problem.resolution**2 > 0


@pytest.mark.parametrize("loss", options("loss"))
def test_losses(loss: str) -> None:
    scale = [] if loss == "square" else ["loss.scale=500"]
    experiment = build(composed([f"loss={loss}", *scale]))
    assert type(experiment.problem.rho).__name__.lower() == loss


def test_a_removed_option_names_its_successor() -> None:
    with pytest.raises(ConfigError, match="was removed; use miho_gn_asynchronous"):
        composed(["optimizer=miho_asynchronous"])
    with pytest.raises(ConfigError, match=r"use miho\.optim\.AsynchronousMIHOGN"):
        build(composed(["dataset=tire_lf", "optimizer._target_=miho.optim.AsynchronousMIHO"]))


@pytest.mark.parametrize("budget", options("budget"))
def test_budgets(budget: str) -> None:
    assert build(composed([f"budget={budget}"])).budget != Budget()


def test_the_arena_is_everything_but_what_it_says() -> None:
    comparison = composed(["experiment=arena"]).comparison
    sets = chosen_problems(composed(["experiment=arena_sets"]).comparison.problems)
    assert sets == SETS
    assert sorted([*chosen_problems(comparison.problems), *sets]) == options("problem")
    assert set(options("optimizer")) - set(comparison.methods) == {
        "gbo_small", "gbo_large", "miho_gn_asynchronous"
    }  # fmt: skip


def test_problems_are_chosen_by_name_or_pattern_and_once() -> None:
    chosen = chosen_problems(["nist_misra1a_starts", "nist_misra1a_*", "tire_l*", "tire_?r"])
    assert chosen[:2] == ["nist_misra1a_starts", "nist_misra1a_log"]
    assert chosen[2:] == ["tire_lf", "tire_lr", "tire_rr"]
    for unknown in ("nits_*", "nist_typo"):
        with pytest.raises(ConfigError) as caught:
            chosen_problems(["tire_lf", unknown])
        message = str(caught.value)
        assert message.startswith(f"comparison.problems={unknown}: is unknown; the closest of ")
        assert message.count("nist_") == 5 + (unknown == "nist_typo")
        assert message.endswith("; python -m experiments.identify problem --help lists all")


@pytest.mark.parametrize("name", slow_drives(options("experiment")))
def test_experiments(name: str) -> None:
    cfg = composed([f"experiment={name}"])
    assert cfg.root == f"runs/{name}"
    assert set(chosen_problems(cfg.comparison.problems)) <= set(options("problem"))
    build(cfg)
    swept = OmegaConf.select(OmegaConf.load(CONF / "experiment" / f"{name}.yaml"), SWEPT) or ""
    assert set(filter(None, swept.split(","))) <= set(options_of("optimizer"))
    for method, settings in cfg.comparison.methods.items():
        if method in NEEDS_A_LIBRARY and find_spec(NEEDS_A_LIBRARY[method]) is None:
            continue
        node = OmegaConf.load(CONF / "optimizer" / f"{method}.yaml")
        assert set(settings) <= set(node), method
        cfg.optimizer = OmegaConf.merge(node, settings)
        build_optimizer(cfg)


def test_a_setting_of_null_reaches_the_method() -> None:
    overrides = chosen_method("least_squares", {"rounds": None, "screen": 7, "method": "lm"})
    expected = LeastSquares(screen=7, rounds=None, method="lm")
    assert build(composed(overrides)).optimizer == expected


@pytest.mark.parametrize("problem", ["torque_05", "torque_15", "torque_20"])
def test_the_optimum_of_a_torque_is_not_where_methods_start(problem: str) -> None:
    """The common start is drawn around the middle of the box, with a quarter of its width."""
    fit = build(composed([f"problem={problem}"])).problem
    optimum, space = linear_optimum(fit), fit.space
    assert optimum is not None
    place = (optimum[0] - space.low) / (space.high - space.low)
    assert (np.abs(place - 0.5) > 0.25).all()
    assert (np.abs(place - 0.5) < 0.45).all()


def test_paper_fig6_is_full_size() -> None:
    params = OmegaConf.load(CONF / "experiment" / "paper_fig6.yaml").hydra.sweeper.params
    assert params.seed == "range(20)"
    assert set(params.optimizer.split(",")) >= {
        "miho", "gbo_small", "gbo_large", "pso_100", "pso_500", "optuna_hyperband"
    }  # fmt: skip
    optimizer = composed(["optimizer=miho"]).optimizer
    assert (optimizer.R, optimizer.eta) == (10_000, 5)


@pytest.mark.parametrize("name", ["ims_obstacle", "lvms_laps"])
def test_the_drives_of_the_paper_are_those_of_its_method(name: str) -> None:
    """Whatever the default: their published figures are."""
    assert composed([f"experiment={name}"]).method == "miho"


def test_targets_lie_in_our_packages() -> None:
    for path in set(CONF.rglob("*.yaml")) - set((CONF / "hydra").rglob("*.yaml")):
        for line in path.read_text(encoding="utf-8").splitlines():
            if "_target_" in line:
                assert line.split(":")[1].strip().split(".")[0] in {"miho", "baselines"}, path


def test_the_seed_and_the_settings_key_the_run() -> None:
    def key(*overrides: str) -> str:
        return build(composed(["optimizer=miho", *overrides])).identity.id

    assert key() == key("seed=0", "root=elsewhere")
    others = [key("seed=1"), key("optimizer.R=7"), key("space.B.high=100"), key("dataset.n=10")]
    assert len({key(), *others}) == 5
    assert OmegaConf.select(composed([]), "dataset.tire") == "lf"


def test_the_order_of_a_space_means_nothing() -> None:
    setting = dict(plain(composed(["dataset.n=100"])))
    names = build_problem(setting).space.names
    setting["space"] = dict(reversed(setting["space"].items()))
    assert build_problem(setting).space.names == names == (*reversed(setting["space"]),)
