"""A mirror never harms a sweep, and a sync makes it equal the files."""

import importlib.util
import json
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from urllib.parse import unquote, urlparse

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf

from experiments.app.build import ConfigError
from experiments.app.compose import composed
from experiments.app.instantiation import MissingLibraryError
from experiments.app.mirror import (
    Tracker,
    check_tracking,
    digest_of,
    message_of,
    mirror,
    sync,
)
from experiments.app.mlflow_tracker import connect, numbers_of, word
from experiments.app.plan import requests
from experiments.app.runs import run
from experiments.app.schema import SweepConfig
from experiments.sync import pages_need
from miho import Budget, load_runs, minimize
from miho.optim import RandomSearch
from miho.study import Identity, Store, StoredRun, execute
from miho.testing import DecayFit

ROOT = Path(__file__).parent.parent
SHARED = ("--experiment", "shared")
needs_mlflow = pytest.mark.skipif(
    importlib.util.find_spec("mlflow") is None, reason="mlflow is not installed (extra mlflow)"
)


def sweep(root: Path, seeds: range) -> list[StoredRun]:
    runs = []
    for seed in seeds:
        config = {"optimizer": {"n": 1, "name": "a"}, "space": {"a b": None}}
        identity = Identity("decay", "random", seed, config, "c0de", "da7a")
        record = minimize(RandomSearch(), DecayFit(), Budget(evaluations=40), seed)
        facts = {"unit": "V"}
        execution = execute(Store(root), identity, lambda r=record: r, DecayFit.space, facts)
        assert execution.run is not None
        runs.append(execution.run)
    return runs


def folders(root: Path) -> list[Path]:
    return [Path(folder) for folder in load_runs(root).runs["folder"]]


@dataclass
class Remembered(Tracker):
    """A tracker in memory that refuses the runs it is told to."""

    held: dict[str, str] = field(default_factory=dict)
    refused: frozenset[int] = frozenset()
    tried: list[int] = field(default_factory=list)
    seconds: float = 0.0

    def digests(self) -> set[str]:
        return set(self.held.values())

    def add(self, stored: StoredRun) -> None:
        seed = stored.result["seed"]
        self.tried.append(seed)
        time.sleep(self.seconds)
        if seed in self.refused:
            raise ConnectionError("cannot reach http://me:hidden@tracker:5000/api")
        self.held[stored.result["id"]] = digest_of(stored)


def test_numbers_are_those_of_the_tables(tmp_path: Path) -> None:
    (stored,) = sweep(tmp_path, range(1))
    row = load_runs(tmp_path).runs.iloc[0]
    numbers = numbers_of(stored)
    assert {key: row[key] for key in numbers} == numbers
    assert set(numbers) >= {"error", "evaluations", "seconds", "theta.a", "theta.b"}
    none = replace(stored, result={**stored.result, "loss": None, "theta": None})
    assert "error" not in numbers_of(none)
    assert not any(key.startswith("theta") for key in numbers_of(none))


def test_a_sync_counts_and_catches_up(tmp_path: Path) -> None:
    sweep(tmp_path, range(6))
    tracker = Remembered(refused=frozenset({2}))
    first = sync(folders(tmp_path), tracker)
    assert (first.there, first.added, len(first.failed)) == (0, 5, 1)
    assert "hidden" not in str(first.failed)
    tracker.refused = frozenset()
    tracker.held[next(iter(tracker.held))] = "another result"
    second = sync(folders(tmp_path), tracker)
    assert (second.there, second.added, second.failed) == (4, 2, {})
    assert sync(folders(tmp_path), tracker).there == 6


def test_a_dead_tracker_is_given_up(tmp_path: Path) -> None:
    sweep(tmp_path, range(8))
    tracker = Remembered(refused=frozenset(range(8)))
    assert len(sync(folders(tmp_path), tracker).failed) == 8
    assert len(tracker.tried) == 3


def test_a_slow_tracker_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    sweep(tmp_path, range(8))
    monkeypatch.setattr("experiments.app.mirror.SLOW_SECONDS", 0.01)
    tracker = Remembered(seconds=0.02)
    mirror(tmp_path, folders(tmp_path), lambda: tracker)
    assert len(tracker.held) == 3
    assert capsys.readouterr().err == (
        "mirror: 5 of 8 runs may not be in the tracker (not tried after several failures or slow "
        f"answers); run python -m experiments.sync {tmp_path}\n"
    )
    assert sync(folders(tmp_path), tracker).added == 5, "a sync waits"


@pytest.mark.parametrize("error", [OSError("the disk is full"), RuntimeError("of another version")])
def test_a_failure_is_said_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], error: Exception
) -> None:
    sweep(tmp_path, range(2))

    def broken() -> Tracker:
        raise error

    mirror(tmp_path, folders(tmp_path), broken)
    message = capsys.readouterr().err
    assert message.startswith(f"mirror: 2 of 2 runs may not be in the tracker ({error}); ")
    assert message.count("\n") == 1


def test_an_interrupt_goes_on_and_says_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sweep(tmp_path, range(2))

    def interrupted() -> Tracker:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mirror(tmp_path, folders(tmp_path), interrupted)
    assert "2 of 2 runs may not be in the tracker (interrupted)" in capsys.readouterr().err


def test_an_interrupted_sweep_says_how_to_mirror_what_it_has_finished(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    small = ["optimizer=random", "budget.evaluations=20", f"root={tmp_path}"]
    plan = requests(composed(small), "", [0, 1])
    assert run(plan[:1], SweepConfig(), here=True).stopped is None
    capsys.readouterr()
    monkeypatch.setattr("experiments.app.runs._do", interrupted)
    assert run(plan, SweepConfig(), here=True).stopped is not None
    assert capsys.readouterr().err == "", "nothing is mirrored without a tracker"
    monkeypatch.setattr("experiments.app.mirror.check_tracking", lambda _: True)
    assert run(plan, SweepConfig(), here=True).stopped is not None
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("mirror: 1 of 1 runs may not be in the tracker (interrupted)")
    assert line.endswith(f"run python -m experiments.sync {tmp_path}")


def test_a_healthy_mirror_is_silent_and_whole(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sweep(tmp_path, range(5))
    tracker = Remembered()
    mirror(tmp_path, folders(tmp_path), lambda: tracker)
    assert len(tracker.held) == 5
    assert capsys.readouterr().err == ""


def test_messages_are_short_and_hold_no_password() -> None:
    text = message_of(ValueError("at  http://user:secret@host/path\nand " + "x" * 1000))
    assert text.startswith("at http://host/path and x")
    assert len(text) == 200
    assert message_of(KeyError()) == "KeyError"
    assert word("theta.mu:y/ä") == "theta.mu_y__"


def test_mlflow_is_an_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mlflow", None)
    tracking = {"tracker": "mlflow"}
    for start in (lambda: check_tracking(tracking), lambda: connect(tmp_path)):
        with pytest.raises(MissingLibraryError, match=r"pip install 'miho\[mlflow\]'"):
            start()


@pytest.mark.parametrize("flask", [False, True])
def test_what_the_pages_need_is_said(flask: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """The extra writes with mlflow-skinny; its `mlflow ui` ends in "No module named 'flask'"."""
    pytest.importorskip("mlflow")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object() if flask else None)
    install = f"pip install mlflow=={version('mlflow-skinny')} && "
    assert pages_need().endswith("" if flask else install)
    assert bool(pages_need()) is not flask


def test_a_configuration_chooses() -> None:
    for path in sorted((ROOT / "conf" / "tracking").glob("*.yaml")):
        settings = OmegaConf.load(path)
        assert set(settings) == {"tracker", "uri", "experiment"}
        assert settings.tracker in (None, path.stem)
    assert not check_tracking(OmegaConf.load(ROOT / "conf" / "tracking" / "none.yaml"))
    with pytest.raises(ConfigError, match=r"tracking.tracker: is 'wandb'; expected mlflow"):
        check_tracking({"tracker": "wandb"})


@pytest.fixture
def other_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """An MLflow of another version, which notes what it finds when it is imported."""
    package = tmp_path / "site" / "mlflow"
    package.mkdir(parents=True)
    noted = 'import os\n__version__ = "4.0.1"\nSEEN = os.environ["MLFLOW_DISABLE_TELEMETRY"]\n'
    (package / "__init__.py").write_text(noted)
    (package / "entities.py").touch()
    monkeypatch.syspath_prepend(str(package.parent))
    monkeypatch.setenv("MLFLOW_DISABLE_TELEMETRY", "false")
    for name in ("DO_NOT_TRACK", "MLFLOW_HTTP_REQUEST_MAX_RETRIES", "MLFLOW_HTTP_REQUEST_TIMEOUT"):
        monkeypatch.setenv(name, "1")
    for name in [name for name in sys.modules if name.partition(".")[0] == "mlflow"]:
        monkeypatch.delitem(sys.modules, name)
    yield
    for name in ("mlflow", "mlflow.entities"):
        sys.modules.pop(name, None)


@pytest.mark.usefixtures("other_version")
def test_another_version_is_refused_and_telemetry_is_off_before(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"mlflow: is version 4\.0\.1; expected at least 3\.10"):
        connect(tmp_path)
    assert sys.modules["mlflow"].SEEN == "true"


def run_sync(*arguments: object) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", "experiments.sync", *map(str, arguments)]
    return subprocess.run(line, cwd=ROOT, capture_output=True, text=True, timeout=170, check=False)


MIRROR = """\
import sys
from functools import partial
from pathlib import Path
from experiments.app.mirror import mirror
from experiments.app.compose import composed
from experiments.app.mlflow_tracker import connect
from experiments.app.plan import requests
from experiments.app.runs import run
from experiments.app.schema import SweepConfig
root, uri, name, *folders = sys.argv[1:]
mirror(Path(root), list(map(Path, folders)), partial(connect, Path(root), uri, name))
"""


def run_mirror(root: Path, uri: str, runs: list[StoredRun]) -> subprocess.CompletedProcess[str]:
    """What a sweep does at its end, in a process of its own."""
    line = [sys.executable, "-c", MIRROR, str(root), uri, SHARED[1]]
    line += [str(stored.folder) for stored in runs]
    return subprocess.run(line, cwd=ROOT, capture_output=True, text=True, timeout=170, check=False)


def check_database(database: Path, files: list[StoredRun]) -> dict[str, Path]:
    """Compare the tables of MLflow, read without MLflow, to the files; artifacts by run id."""
    with sqlite3.connect(database) as connection:
        rows = connection.execute(
            "SELECT t.value, r.run_uuid, r.status, r.artifact_uri FROM runs r JOIN tags t ON "
            "t.run_uuid = r.run_uuid AND t.key = 'miho.id' WHERE r.lifecycle_stage = 'active'"
        ).fetchall()

        assert sorted(row[0] for row in rows) == sorted(stored.result["id"] for stored in files)
        of = {row[0]: row[1:] for row in rows}
        for stored in files:
            key, status, _ = of[stored.result["id"]]
            assert status == "FINISHED"
            points = pd.read_sql_query(
                "SELECT key, value, timestamp, step FROM metrics WHERE run_uuid = ? ORDER BY step",
                connection, params=[key],
            )  # fmt: skip
            numbers = numbers_of(stored)
            last = points.groupby("key")["value"].last()
            assert {name: last[name] for name in numbers} == numbers
            curve = points[points["key"] == "error"]
            expected = pd.DataFrame(
                {k: stored.curve[k] for k in ("evaluations", "seconds", "loss")}
            )
            assert curve["step"].tolist() == expected["evaluations"].tolist()
            assert curve["value"].tolist() == np.sqrt(expected["loss"]).tolist()
            at_end = expected["evaluations"] == stored.result["evaluations"]
            expected.loc[at_end, "seconds"] = stored.result["seconds"]
            start = pd.Timestamp(stored.environment["time"]).timestamp() * 1000
            late = curve["timestamp"].to_numpy() - start - 1000 * expected["seconds"]
            assert np.abs(late).max() <= 0.5 + 1e-3, "milliseconds, rounded"
            params = dict(
                connection.execute("SELECT key, value FROM params WHERE run_uuid = ?", [key])
            )
            assert params == {"optimizer.n": "1", "optimizer.name": "a", "space.a b": "null"}
            tags = dict(connection.execute("SELECT key, value FROM tags WHERE run_uuid = ?", [key]))
            for name in ("problem", "optimizer", "seed", "outcome", "code", "data"):
                assert tags[f"miho.{name}"] == str(stored.result[name])
    connection.close()
    return {run: Path(unquote(urlparse(row[2]).path)) for run, row in of.items()}


@pytest.mark.slow
@needs_mlflow
def test_mlflow_equals_the_files(tmp_path: Path) -> None:
    root = tmp_path / "my runs"
    files = sweep(root, range(4))
    (root / "figures").mkdir()
    (root / "figures" / "fig.png").write_bytes(b"picture")
    (root / "report.html").write_text("<p>page</p>")
    (tmp_path / "private.png").write_bytes(b"private")
    (root / "figures" / "link.png").symlink_to(tmp_path / "private.png")
    process = run_sync(root)
    assert process.returncode == 0, process.stderr
    assert "4 runs: 0 were there, 4 added, 0 failed; 2 figures" in process.stdout
    database = root / ".mlflow" / "mlflow.db"
    places = check_database(database, files)
    for stored in files:
        place = places[stored.result["id"]]
        curve = pd.read_csv(place / "curve.csv")
        assert curve["evaluations"].tolist() == stored.curve["evaluations"]
        assert curve["error"].tolist() == np.sqrt(stored.curve["loss"]).tolist()
        assert json.loads((place / "config.json").read_text()) == stored.config
    assert [path.name for path in database.parent.rglob("*.png")] == ["fig.png"]
    assert len(list(database.parent.rglob("report.html"))) == 1
    assert load_runs(root).damaged.empty
    assert len(load_runs(root).runs) == 4

    with sqlite3.connect(database) as connection:
        connection.execute(
            "UPDATE runs SET status = 'RUNNING' WHERE run_uuid IN "
            "(SELECT run_uuid FROM tags WHERE key = 'miho.seed' AND value = '1')"
        )
    connection.close()
    again = run_sync(root)
    assert "4 runs: 3 were there, 1 added, 0 failed; 0 figures" in again.stdout
    check_database(database, files)


@pytest.mark.slow
@needs_mlflow
def test_mlflow_down_is_one_line(tmp_path: Path) -> None:
    sweep(tmp_path, range(1))
    process = run_sync(tmp_path, "--uri", "http://me:hidden@127.0.0.1:9")
    assert process.returncode == 4
    assert process.stderr.startswith("error: mlflow: ")
    assert process.stderr.count("\n") == 1
    assert "hidden" not in process.stderr


@pytest.mark.slow
@needs_mlflow
def test_four_sweeps_on_one_fresh_database(tmp_path: Path) -> None:
    """Four processes start on a database that is not there; then four mirrors write to it."""
    uri = f"sqlite:///{tmp_path / 'shared' / 'mlflow.db'}"
    roots = [tmp_path / f"sweep{i}" for i in range(4)]
    files = [stored for i, root in enumerate(roots) for stored in sweep(root, seeds(i, 0))]
    with ThreadPoolExecutor(4) as pool:
        processes = list(pool.map(lambda root: run_sync(root, "--uri", uri, *SHARED), roots))
    assert [each.returncode for each in processes] == [0] * 4, [each.stderr for each in processes]
    assert all("10 runs: 0 were there, 10 added" in each.stdout for each in processes)
    check_database(tmp_path / "shared" / "mlflow.db", files)

    later = [sweep(root, seeds(i, 1)) for i, root in enumerate(roots)]
    with ThreadPoolExecutor(4) as pool:
        processes = list(pool.map(lambda root, runs: run_mirror(root, uri, runs), roots, later))
    assert [(each.returncode, each.stderr) for each in processes] == [(0, "")] * 4
    files += [stored for runs in later for stored in runs]
    check_database(tmp_path / "shared" / "mlflow.db", files)
    with ThreadPoolExecutor(4) as pool:
        processes = list(pool.map(lambda root: run_sync(root, "--uri", uri, *SHARED), roots))
    assert [each.returncode for each in processes] == [0] * 4, [each.stderr for each in processes]
    check_database(tmp_path / "shared" / "mlflow.db", files)


def seeds(sweep_number: int, part: int) -> range:
    first = 100 * sweep_number + 10 * part
    return range(first, first + 10)
