"""What a fingerprint of a model leaves out, since it changes from process to process or version."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from miho.models.fingerprint import fingerprint

COUNTER = """
CALLS = 0

def count():
    global CALLS
    CALLS += 1

def reset():
    global CALLS
    CALLS = 0

def model(t, a):
    {call}()
    if CALLS % 1000 == 0:
        print(CALLS)
    return a * t
"""


def module(text: str, **members: Any) -> dict[str, Any]:
    """The names of a module of this text."""
    names: dict[str, Any] = {"__name__": "own", **members}
    exec(text, names)
    return names


@pytest.mark.parametrize("call", ["count", "reset"])
def test_a_counter_that_a_helper_writes_does_not_count(call: str) -> None:
    names = module(COUNTER.format(call=call))
    before = fingerprint(names["model"])
    names["CALLS"] = 7
    assert fingerprint(names["model"]) == before


def test_a_number_that_no_function_of_the_model_writes_counts() -> None:
    names = module(COUNTER.format(call="print"))
    before = fingerprint(names["model"])
    names["CALLS"] = 7
    assert fingerprint(names["model"]) != before


def test_a_local_name_that_is_written_hides_no_number_of_the_module() -> None:
    text = """
def gain(): return c
def model(t, a):
    c = 0
    def count():
        nonlocal c
        c += 1
    count()
    return gain() * a * t
"""
    assert fingerprint(module(text, c=1.0)["model"]) != fingerprint(module(text, c=2.0)["model"])


def test_a_counter_of_a_closure_does_not_count() -> None:
    def made() -> Callable[[float], float]:
        calls = 0

        def count() -> None:
            nonlocal calls
            calls += 1

        def model(a: float) -> float:
            count()
            return a if calls else 0.0

        return model

    model = made()
    before = fingerprint(model)
    model(1.0)
    assert fingerprint(model) == before


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("/tmp/tmpabc", "/tmp/tmpxyz", True),
        (Path("first"), Path("second"), True),
        ("12:01:15", "12:01:16", True),
        (1795000000.25, 1795000060.5, True),  # time.time()
        (1795000000123456789, 1795000060123456789, True),  # time.time_ns()
        (1795000000.0, 1795000060.0, False),
        (1000000007, 2147483647, False),
        ("linear", "cubic", False),
        (1.0, 2.0, False),
    ],
)
def test_paths_and_stamps_of_a_module_do_not_count(one: Any, other: Any, same: bool) -> None:
    text = "def model(t, a): return (a * t, c)"
    prints = [fingerprint(module(text, c=value)["model"]) for value in (one, other)]
    assert (prints[0] == prints[1]) is same


@pytest.mark.parametrize(("name", "same"), [("miho.models.own", True), ("own", False)])
def test_code_of_our_classes_does_not_count_but_settings_do(name: str, same: bool) -> None:
    def of(gain: float, factor: float) -> str:
        members = {"__module__": name, "of": lambda self, a: factor * self.gain * a}
        thing: Any = type("Gain", (), members)()
        thing.gain = gain
        return fingerprint(thing)

    assert (of(1.0, 1.0) == of(1.0, 2.0)) is same
    assert of(1.0, 1.0) != of(2.0, 1.0)
