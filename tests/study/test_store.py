"""Runs on disk: written once, whole or not at all, never silently wrong."""

import json
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from miho import Budget, load_runs, minimize
from miho.optim import Descents, Minimum, RandomSearch, RunRecord, Trace
from miho.study import DamagedRun, Identity, RunInUse, Status, Store, execute, read_run
from miho.testing import DecayFit

FACTS = {"unit": "V"}


def identity(seed: int = 0, optimizer: str = "random", **config: object) -> Identity:
    return Identity("decay", optimizer, seed, config, code="c0de", data="da7a")


def record(seed: int = 0) -> RunRecord:
    return minimize(RandomSearch(), DecayFit(), Budget(evaluations=50), seed)


def filled(root: Path, seeds: int = 3) -> Store:
    store = Store(root)
    for seed in range(seeds):
        execute(store, identity(seed), lambda seed=seed: record(seed), DecayFit.space, FACTS)
    return store


def test_round_trip(tmp_path: Path) -> None:
    filled(tmp_path)
    found = load_runs(tmp_path)
    expected = record(1)
    row = found.runs.set_index("seed").loc[1]
    assert row["error"] == np.sqrt(expected.loss)
    assert [row["theta.a"], row["theta.b"]] == list(expected.theta)
    assert (row["unit"], row["outcome"], row["evaluations"]) == ("V", "budget", 50)
    curve = found.curves[found.curves["seed"] == 1]
    assert curve["error"].tolist()[: len(expected.trace)] == np.sqrt(expected.trace.loss).tolist()
    assert curve["evaluations"].iloc[-1] == 50, "the curve is closed where the run ended"
    assert found.damaged.empty


def test_descents_are_kept(tmp_path: Path) -> None:
    minima = (Minimum(1.0, (0.5, 2.0)), Minimum(4.0, (3.0, 1.0)))
    descents = Descents(3, 2, 2, 0, (1.0, 4.0), 60, 1, minima=minima)
    run = replace(record(), descents=descents)
    stored = execute(Store(tmp_path), identity(), lambda: run, DecayFit.space, FACTS).run
    assert stored is not None
    assert stored.result["descents"] == {
        "started": 3, "finished": 2, "converged": 2, "stayed": 0, "ends": [1.0, 4.0],
        "screened": 60, "agreeing": 1, "dropped": 0, "brackets": False, "settled": True,
        "minima": [[1.0, [0.5, 2.0]], [4.0, [3.0, 1.0]]],
    }  # fmt: skip
    assert Descents.from_stored(stored.result["descents"]) == descents


def test_a_creeping_curve_is_stored_to_its_resolution(tmp_path: Path) -> None:
    trace = Trace()
    for i in range(50_000):
        trace.add(i + 1, i * 1e-3, i * 1e-3, float(np.exp(-i * 1e-5)), np.zeros(2))
    plain = record()
    crept = replace(plain, trace=trace, loss=trace.loss[-1], evaluations=50_000)
    execute(Store(tmp_path), identity(), lambda: crept, DecayFit.space, FACTS)
    curve = load_runs(tmp_path).curves
    assert len(curve) < 2500
    assert curve["error"].iloc[-1] == np.sqrt(trace.loss[-1])
    at = np.searchsorted(curve["evaluations"], trace.evaluations, side="right") - 1
    ratio = curve["error"].to_numpy()[at] ** 2 / np.array(trace.loss)
    assert ratio.min() >= 1 - 1e-12
    assert ratio.max() <= 1.00101
    for error in np.sqrt(trace.loss[::997]):
        true = trace.evaluations[np.flatnonzero(np.sqrt(trace.loss) <= error)[0]]
        stored = curve["evaluations"][curve["error"] <= error].iloc[0]
        assert true <= stored <= 1.0101 * true + 1


def test_a_root_may_be_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = filled(tmp_path, seeds=1).folder(identity(0))
    monkeypatch.chdir(tmp_path)
    assert read_run(folder.relative_to(tmp_path)).result["id"] == folder.name


def test_a_copied_folder_is_not_a_second_run(tmp_path: Path) -> None:
    store = filled(tmp_path, seeds=1)
    folder = store.folder(identity(0))
    shutil.copytree(folder, tmp_path / "decay" / "other" / folder.name)
    (folder.parent / "0000000000000000").mkdir()
    (folder.parent / "0000000000000000" / "result.json").write_text("[" * 200_000)
    found = load_runs(tmp_path)
    assert len(found.runs) == 1
    assert len(found.damaged) == 2


def test_done_runs_do_not_run_again(tmp_path: Path) -> None:
    store = filled(tmp_path)

    def never() -> RunRecord:
        raise RuntimeError("ran again")

    execution = execute(store, identity(1), never, DecayFit.space, FACTS)
    assert execution.status is Status.DONE_BEFORE


@pytest.mark.parametrize(
    "other",
    [
        identity(1),
        identity(0, optimizer="miho"),
        identity(0, R=3),
        Identity("decay", "random", 0, {}, "other code", "da7a"),
        Identity("decay", "random", 0, {}, "c0de", "other data"),
    ],
)
def test_what_differs_is_another_run(other: Identity) -> None:
    assert other.id != identity(0).id
    assert identity(0, a=1, b=2).id == identity(0, b=2, a=1).id


@pytest.mark.parametrize("name", ["config.json", "environment.json", "curve.json", "result.json"])
def test_every_damage_is_found(tmp_path: Path, name: str) -> None:
    store = filled(tmp_path)
    folder = store.folder(identity(1))
    path = folder / name
    good = path.read_bytes()
    rng = np.random.default_rng(0)
    bad = [good[:n] for n in rng.integers(0, len(good), 100)]
    for position in rng.integers(0, len(good) * 8, 100).tolist():
        flipped = bytearray(good)
        flipped[position // 8] ^= 1 << position % 8
        bad.append(bytes(flipped))
    bad.append(good[:-20] + bytes(20))
    bad.append((store.folder(identity(2)) / name).read_bytes() + b" " * (name == "config.json"))
    for data in bad:
        if data == good:  # the same second has the same environment
            continue
        path.write_bytes(data)
        with pytest.raises(DamagedRun):
            read_run(folder)
    found = load_runs(tmp_path)
    assert found.runs["seed"].tolist() in ([0, 2], [2, 0])
    assert found.damaged["folder"].tolist() == [str(folder)]
    assert store.find(identity(1)) is None, "so that it runs anew"


def test_a_run_without_result_is_not_done(tmp_path: Path) -> None:
    store = filled(tmp_path)
    (store.folder(identity(1)) / "result.json").unlink()
    assert len(load_runs(tmp_path).runs) == 2
    execution = execute(store, identity(1), lambda: record(1), DecayFit.space, FACTS)
    assert execution.status is Status.RAN


def test_a_failing_write_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = filled(tmp_path, seeds=1)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*.json")}

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        execute(store, identity(7), lambda: record(7), DecayFit.space, FACTS)
    monkeypatch.undo()
    assert {p: p.read_bytes() for p in tmp_path.rglob("*.json")} == before
    assert not list(tmp_path.rglob(".*.json.*")), "no temporary file stays behind"
    execution = execute(store, identity(7), lambda: record(7), DecayFit.space, FACTS)
    assert execution.status is Status.RAN


def test_interrupted_and_failed_runs_keep_their_curve_and_run_again(tmp_path: Path) -> None:
    store = Store(tmp_path)

    def interrupted() -> RunRecord:
        def stop(_: object) -> None:
            signal.raise_signal(signal.SIGINT)

        return minimize(RandomSearch(), DecayFit(), Budget(evaluations=10**6), observer=stop)

    execution = execute(store, identity(), interrupted, DecayFit.space, FACTS)
    assert execution.status is Status.INTERRUPTED
    assert execution.partial is not None
    assert json.loads(execution.partial.read_text())["curve"]["loss"]
    assert load_runs(tmp_path).runs.empty
    assert execute(store, identity(), record, DecayFit.space, FACTS).status is Status.RAN
    assert not execution.partial.exists()


def test_a_partial_run_that_was_altered_says_nothing(tmp_path: Path) -> None:
    store = Store(tmp_path)
    path = store.keep_reason(identity(), "killed by SIGKILL", None, "interrupted")
    assert store.reason(identity()) == "killed by SIGKILL"
    good = path.read_bytes()
    rng = np.random.default_rng(0)
    for cut in range(0, len(good), 7):
        path.write_bytes(good[:cut])
        assert store.reason(identity()) is None
    for _ in range(50):
        at, bit = int(rng.integers(len(good))), int(rng.integers(8))
        path.write_bytes(good[:at] + bytes([good[at] ^ 1 << bit]) + good[at + 1 :])
        assert store.reason(identity()) is None
    path.write_bytes(good)
    assert store.reason(identity()) == "killed by SIGKILL"


HOLD = """
import sys
from miho.study import Identity, Store

identity = Identity("decay", "random", 0, {}, code="c0de", data="da7a")
with Store(__import__("pathlib").Path(sys.argv[1])).claim(identity):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.mark.slow
def test_two_processes_do_not_run_the_same(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(RunInUse), Store(tmp_path).claim(identity()):
            pass
        execution = execute(Store(tmp_path), identity(), record, DecayFit.space, FACTS)
        assert execution.status is Status.RUNNING_ELSEWHERE
        other.communicate()
    assert other.returncode == 0
    assert execute(Store(tmp_path), identity(), record, DecayFit.space, FACTS).status is Status.RAN


@pytest.mark.parametrize("name", ["../up", "/absolute", "", ".", "a b", "a/b", "a\0b", "x" * 101])
def test_names_stay_below_the_root(name: str) -> None:
    with pytest.raises(ValueError, match="cannot name a folder"):
        identity(optimizer=name)


def test_an_absent_root_says_so(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="run something first"):
        load_runs(tmp_path / "nothing")
