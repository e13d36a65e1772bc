"""Columns of settings: what differs among runs of one method or problem, and nothing else."""

from __future__ import annotations

import json
from typing import Any

import pytest

from miho.study.settings import RunRequest, differing, is_setting, parts_of


def request(
    config: dict[str, Any],
    seed: int = 0,
    optimizer: str = "miho",
    problem: str = "tire",
    code: str = "c0de",
    data: str = "da7a",
) -> RunRequest:
    return RunRequest(problem, optimizer, seed, parts_of(json.dumps(config).encode()), code, data)


def columns(*runs: RunRequest) -> dict[str, list[Any]]:
    return differing(runs).to_dict("list")


def test_what_differs_is_a_column_named_as_on_the_command_line() -> None:
    first = {"optimizer": {"R": 300, "eta": 5}, "dataset": {"n": 500, "tire": {"side": "l"}}}
    other = {"optimizer": {"R": 1000, "eta": 5}, "dataset": {"n": 500, "tire": {"side": "r"}}}
    assert columns(request(first), request(other)) == {
        "optimizer.R": [300, 1000], "dataset.tire.side": ["l", "r"]
    }  # fmt: skip


def test_methods_and_problems_do_not_bring_settings_of_their_own() -> None:
    swarm = {"optimizer": {"particles": 100}, "dataset": {"n": 500}}
    miho = {"optimizer": {"R": 300}, "dataset": {"n": 500}}
    engine = {"optimizer": {"R": 300}, "dataset": {"n": 80}}
    runs = request(swarm, optimizer="pso"), request(miho), request(engine, problem="engine")
    assert columns(*runs) == {}


def test_a_setting_of_one_method_is_absent_in_another() -> None:
    runs = [request({"optimizer": {"R": R}}) for R in (300, 1000)]
    table = differing([*runs, request({"optimizer": {}}, optimizer="random")])
    assert table["optimizer.R"].isna().tolist() == [False, False, True]


def test_what_all_methods_of_a_problem_share_is_compared_among_them() -> None:
    long, short = {"budget": {"seconds": 30}}, {"budget": {"seconds": 4}}
    assert columns(request(long), request(short, optimizer="pso")) == {"budget.seconds": [30, 4]}


def test_what_follows_the_seed_is_no_setting() -> None:
    runs = [request({"optimizer": {"start": seed}}, seed) for seed in (3, 4)]
    assert columns(*runs) == {}
    assert columns(*runs, request({"optimizer": {"start": 9}}, 5)) == {"optimizer.start": [3, 4, 9]}


def test_absent_is_null_and_lists_are_texts() -> None:
    assert columns(request({"a": {"x": None}}), request({"a": {}}), request({})) == {}
    assert columns(request({"a": {"x": [1]}}), request({"a": {"x": [1, 2]}})) == {
        "a.x": ["[1]", "[1,2]"]
    }


def test_other_code_and_data_are_columns_where_nothing_else_explains_them() -> None:
    config = {"dataset": {"path": "a.csv"}}
    assert columns(request(config, data="aaaaaaaa"), request(config, 1, data="bbbbbbbb")) == {
        "data": ["aaaaaa", "bbbbbb"]
    }
    assert columns(request(config, code="aaaaaaaa"), request(config, 1, code="bbbbbbbb")) == {
        "code": ["aaaaaa", "bbbbbb"]
    }
    explained = [request({"dataset": {"n": n}}, data=f"{n}") for n in (1, 2)]
    assert list(differing(explained)) == ["dataset.n"]


@pytest.mark.parametrize("text", [b"3", b"[1]", b"{", b'{"a": 1}', b'{"theta": {"B": 1}}', b"\xff"])
def test_what_holds_no_groups_has_no_settings(text: bytes) -> None:
    assert parts_of(text) == {}


def test_columns_of_parameters_are_no_settings() -> None:
    assert [is_setting(name) for name in ("optimizer.R", "code", "theta.B", "error")] == [
        True, True, False, False
    ]  # fmt: skip
