"""What differs in more than the seed has another name."""

from __future__ import annotations

from miho.analysis.pages.sweep_runs import Sweep
from tests.analysis.sweep_synthetic import origin, sweep_of
from tests.analysis.synthetic import frames


def swept(*configs: dict[str, object], **each: list[str]) -> Sweep:
    """One method, one run per configuration; `each` gives code or data of each run."""
    runs, curves = frames({"miho": [[(1, 2.0)]] * len(configs)})
    runs["seed"] = [config.pop("seed", 0) for config in configs]
    origins = {
        f"miho-{number}": origin(config, **{key: values[number] for key, values in each.items()})
        for number, config in enumerate(configs)
    }
    return sweep_of(runs, curves, **origins)


def test_runs_that_differ_in_the_seed_share_a_name() -> None:
    runs = swept({"seed": 0, "budget": {"seed": 0}}, {"seed": 1, "budget": {"seed": 1}})
    assert set(runs.runs["optimizer"]) == {"miho"}
    assert set(runs.runs["problem"]) == {"pacejka-tire_lf"}
    assert set(runs.curves["optimizer"]) == {"miho"}


def test_settings_that_differ_are_told() -> None:
    runs = swept(
        {"optimizer": {"R": 500, "eta": 5}, "budget": {"evaluations": 10}},
        {"optimizer": {"R": 1000, "eta": 5}, "budget": {"evaluations": 20}},
        {"optimizer": {"R": 1000, "eta": 5}, "budget": {"seconds": 1}},
    )
    assert runs.runs["optimizer"].tolist() == [
        "miho R=500, evaluations=10, seconds=-",
        "miho R=1000, evaluations=20, seconds=-",
        "miho R=1000, evaluations=-, seconds=1",
    ]
    assert runs.curves["optimizer"].unique().tolist() == runs.runs["optimizer"].tolist()


def test_bounds_in_names_have_their_parameters() -> None:
    runs = swept({"space": {"B": {"high": 1}, "C": {"high": 1}}},
                  {"space": {"B": {"high": 2}, "C": {"high": 3}}})  # fmt: skip
    assert runs.runs["optimizer"][1] == "miho B.high=2, C.high=3"


def test_other_data_are_another_problem_and_other_code_another_method() -> None:
    runs = swept({}, {}, data=["aaaaaaaa", "bbbbbbbb"])
    assert runs.runs["problem"].tolist() == [
        "pacejka-tire_lf data=aaaaaa", "pacejka-tire_lf data=bbbbbb",
    ]  # fmt: skip
    assert set(runs.runs["optimizer"]) == {"miho"}
    runs = swept({}, {}, code=["aaaaaaaa", "bbbbbbbb"])
    assert runs.runs["optimizer"].tolist() == ["miho code=aaaaaa", "miho code=bbbbbb"]
    assert runs.runs["problem"].nunique() == 1


def test_another_loss_is_another_problem() -> None:
    runs = swept({"loss": {"_target_": "Huber", "scale": 1}}, {"loss": {"_target_": "Square"}})
    assert runs.runs["problem"][0] == "pacejka-tire_lf _target_=Huber, scale=1"
