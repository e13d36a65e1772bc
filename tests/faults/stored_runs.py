"""Runs with made-up numbers, in any quantity, in the format of the store."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import orjson

from miho.optim import Outcome, Parameter, RunRecord, Space, Trace
from miho.study import Identity, Store, StoredRun, environment_stamp
from miho.study.files import CONFIG, CURVE, ENVIRONMENT, RESULT
from miho.study.identity import sha256

POINTS = 50
NAMES = ("B", "C", "D", "Sx", "Sy")
PROBLEMS, OPTIMIZERS = 10, 10


def make_runs(root: Path, count: int, rng: np.random.Generator) -> list[Path]:
    """Write `count` runs of 50 points and 5 parameters below `root`; returns their folders.

    One run is committed by the store and is the pattern of the others, so that they have its
    format; they are written without waiting for the disk.
    """
    with TemporaryDirectory() as folder:
        pattern = _committed(Path(folder))
    return [_write(root, number, pattern, rng) for number in range(count)]


def _committed(root: Path) -> StoredRun:
    theta = np.zeros(len(NAMES))
    trace = Trace()
    for point in range(POINTS):
        trace.add(point + 1, point + 1.0, point + 1.0, float(POINTS - point), theta)
    seconds = float(POINTS)
    record = RunRecord(Outcome.BUDGET, theta, 1.0, POINTS, seconds, seconds, 0.1, trace, {})
    space = Space(tuple(Parameter(name, "rad", -1.0, 1.0) for name in NAMES))
    config = {"settings": {f"setting_{number}": number / 7 for number in range(40)}}
    identity = Identity("pattern", "pattern", 0, config, code="c0de", data="da7a")
    facts = {"unit": "N", "irreducible": 0.1, "optimum": 0.01}
    store = Store(root)
    with store.claim(identity):
        return store.commit(identity, record, space, environment_stamp(), facts)


def _write(root: Path, number: int, pattern: StoredRun, rng: np.random.Generator) -> Path:
    loss = np.sort(rng.random(POINTS))[::-1].tolist()
    seconds = np.cumsum(rng.random(POINTS)).tolist()
    theta = rng.uniform(-1, 1, (POINTS, len(NAMES))).tolist()
    spent = {"evaluations": np.cumsum(rng.integers(1, 99, POINTS)).tolist(), "seconds": seconds}
    curve = {**pattern.curve, **spent, "cpu_seconds": seconds, "loss": loss, "theta": theta}
    texts = {
        CONFIG: _text({**pattern.config, "number": number}),
        ENVIRONMENT: _text({**pattern.environment, "number": number}),
        CURVE: _text(curve),
    }
    place = {
        "problem": f"problem_{number % PROBLEMS}",
        "optimizer": f"optimizer_{number // PROBLEMS % OPTIMIZERS}",
        "id": f"{number:016x}",
    }
    result: dict[str, Any] = {**pattern.result, **place, "seed": number, "loss": loss[-1]}
    result |= {key: curve[key][-1] for key in ("evaluations", "seconds", "cpu_seconds", "theta")}
    result["files"] = {name: sha256(text) for name, text in texts.items()}
    result["sha256"] = sha256(_text(result))
    folder = root.joinpath(*place.values())
    folder.mkdir(parents=True)
    for name, text in {**texts, RESULT: _text(result)}.items():
        (folder / name).write_bytes(text)
    return folder


def _text(value: dict[str, Any]) -> bytes:
    """As `canonical` writes it, in a tenth of the time; only the digits of floats may differ."""
    return orjson.dumps(value, option=orjson.OPT_SORT_KEYS)
