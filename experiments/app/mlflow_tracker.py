"""Finished runs in MLflow: one experiment, with one run for each of ours and one for the figures.

MLflow stores absolute paths: after a root was moved, delete its folder .mlflow and copy again.
"""

import contextlib
import datetime
import importlib
import json
import logging
import math
import os
import re
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from filelock import FileLock, Timeout

from experiments.app.build import ConfigError
from experiments.app.instantiation import MissingLibraryError
from experiments.app.mirror import MISSING, Tracker, TrackerError, digest_of, message_of
from miho.study import StoredRun
from miho.study.identity import inside, sha256
from miho.study.index import error_of
from miho.study.provenance import flattened

PLACE = ".mlflow"
"""Folder of the database in a root; readers of runs skip names that begin with a dot."""

OLDEST, TOO_NEW = (3, 10), (4, 0)
TELEMETRY_OFF = {"MLFLOW_DISABLE_TELEMETRY": "true", "DO_NOT_TRACK": "true"}
IMPATIENCE = {"MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1", "MLFLOW_HTTP_REQUEST_TIMEOUT": "20"}
"""Defaults unless the environment sets other values; MLflow's are 7 retries and 120 s a request."""

BATCH_METRICS, BATCH_PARAMS, LONGEST_PARAM = 900, 100, 6000
"""MLflow accepts 1000 entries per batch, of which 100 are parameters of at most 6000 characters."""

LOCK_SECONDS = 60.0
FIGURES = {".png", ".pdf", ".svg", ".html", ".md", ".csv"}


@dataclass(frozen=True)
class MLflow(Tracker):
    """One experiment of MLflow, with one entry per run, and a parent entry for the figures.

    The tags of an entry are id, problem, optimizer, seed, outcome and digests of the run. Its
    parameters are the resolved configuration, its metrics the values of `numbers_of`. `error` and
    `seconds` have a point per improvement: the step is the number of evaluations, the timestamp is
    start + seconds of the run, to the millisecond. The status is FINISHED after all is written.
    """

    client: Any
    entities: Any
    experiment: str
    parent: str
    lock: Path

    def digests(self) -> set[str]:
        """`digest_of` each run of the experiment that was written completely."""
        return {_digest(run) for run in self._runs("tags.`miho.id` LIKE '%'")}

    def add(self, stored: StoredRun) -> None:
        """Write a run unless it is there, in place of all that was written of it before."""
        with _locked(self.lock):
            entries = self._runs(f"tags.`miho.id` = '{stored.result['id']}'")
            if digest_of(stored) in map(_digest, entries):  # another process was faster
                return
            for entry in entries:
                self.client.delete_run(entry.info.run_id)
            self._write(stored)

    def _runs(self, matching: str) -> list[Any]:
        """Runs of the experiment that match a filter of MLflow."""
        runs, token, more = [], None, True
        while more:
            page = self.client.search_runs(
                [self.experiment], matching, max_results=1000, page_token=token
            )
            runs += page
            token = page.token
            more = bool(token)
        return runs

    def _write(self, stored: StoredRun) -> None:
        """Write a run in one batch (several for long curves), then its files, then its status."""
        result, facts = stored.result, stored.result["facts"]
        start = _milliseconds(stored.environment)
        names = ("id", "problem", "optimizer", "seed", "outcome", "code", "data")
        tags = {f"miho.{name}": str(result[name]) for name in names}
        tags |= {"miho.digest": digest_of(stored), "miho.unit": str(facts.get("unit"))}
        key = self.client.create_run(
            self.experiment,
            start_time=start,
            tags={**tags, "mlflow.parentRunId": self.parent},
            run_name=f"{result['problem']} {result['optimizer']} {result['seed']}",
        ).info.run_id
        params = [self.entities.Param(k, v) for k, v in _settings(stored.config).items()]
        metrics = [self.entities.Metric(*point) for point in _points(stored, start)]
        while params or metrics:
            self.client.log_batch(
                key, metrics[:BATCH_METRICS], params[:BATCH_PARAMS], (), synchronous=True
            )
            del metrics[:BATCH_METRICS], params[:BATCH_PARAMS]
        with tempfile.TemporaryDirectory() as folder:
            pd.DataFrame(_curve(stored)).to_csv(Path(folder, "curve.csv"), index=False)
            for name in ("config", "environment"):
                text = json.dumps(dict(getattr(stored, name)), indent=1)
                Path(folder, f"{name}.json").write_text(text, encoding="utf-8")
            self.client.log_artifacts(key, folder)
        end = start + round(1000 * result["seconds"])
        self.client.set_terminated(key, "FINISHED", end)

    def attach(self, root: Path) -> int:
        """Attach the figures and tables of the root to the parent, if changed; return how many.

        Links are not followed, because a received folder must not choose other files to upload.
        """
        pages = (path for name in ("figures", "reports") for path in (root / name).rglob("*"))
        files = [
            path
            for path in sorted([*pages, root / "report.html"])
            if path.suffix in FIGURES and path.is_file()
            and path.resolve() == root.resolve() / path.relative_to(root)
        ]  # fmt: skip
        names = [path.relative_to(root).as_posix() for path in files]
        digests = [sha256(path.read_bytes()) for path in files]
        digest = sha256("".join(map("\0".join, zip(names, digests, strict=True))))
        with _locked(self.lock):
            if self.client.get_run(self.parent).data.tags.get("miho.figures") == digest:
                return 0
            for path in files:
                place = path.parent.relative_to(root).as_posix()
                self.client.log_artifact(self.parent, str(path), None if place == "." else place)
            self.client.set_tag(self.parent, "miho.figures", digest)
        return len(files)


def connect(root: Path, uri: str | None = None, experiment: str | None = None) -> MLflow:
    """Connect to MLflow at `uri` (default: SQLite below the root); a new database is initialised.

    `experiment` is by default the name of the root. Raises MissingLibraryError, ConfigError for an
    unsupported version of MLflow, TrackerError if it cannot be reached, and PermissionError if a
    link in the root leads out of it.
    """
    root = root.absolute()
    folder = inside(root, PLACE)
    # No path below a root may lead out of it. MLflow reads the environment at its import.
    for name in ("mlflow.db", "mlflow.db.lock", "lock", "artifacts"):
        inside(root, PLACE, name)
    os.environ.update(TELEMETRY_OFF)
    for name, value in IMPATIENCE.items():
        os.environ.setdefault(name, value)
    try:
        mlflow = importlib.import_module("mlflow")
        entities = importlib.import_module("mlflow.entities")
    except ModuleNotFoundError as error:
        raise MissingLibraryError(MISSING) from error
    version = mlflow.__version__
    if not OLDEST <= tuple(map(int, re.findall(r"\d+", version)[:2])) < TOO_NEW:
        raise ConfigError(f"mlflow: is version {version}; expected at least 3.10 and below 4")
    for noisy in ("alembic", "mlflow"):
        logging.getLogger(noisy).setLevel(logging.ERROR)
    # The lock and the artifacts of a SQLite file are in its folder.
    if uri is None:
        uri = f"sqlite:///{folder / 'mlflow.db'}"
    name = experiment or root.name or "miho"
    database = _database(uri)
    lock = folder / "lock"
    artifacts = None
    if database is not None:
        lock = database.with_name(f"{database.name}.lock")
        artifacts = (database.parent / "artifacts").as_uri()
    # The experiment, and in it the parent entry of this root for the figures.
    with as_tracker_error(), _locked(lock):
        client = mlflow.MlflowClient(uri)
        existing = client.get_experiment_by_name(name)
        if existing is None:
            key = client.create_experiment(name, artifact_location=artifacts)
        elif existing.lifecycle_stage != "active":
            raise TrackerError(f"experiment {name!r} is deleted; restore it or name another")
        else:
            key = existing.experiment_id
        parents = client.search_runs([key], f"tags.`miho.root` = '{sha256(str(root))}'")
        if not parents:
            tags = {"miho.root": sha256(str(root))}
            parents = [client.create_run(key, tags=tags, run_name=f"{root.name} (figures)")]
            client.set_terminated(parents[0].info.run_id)
    return MLflow(client, entities, key, parents[0].info.run_id, lock)


@contextlib.contextmanager
def as_tracker_error() -> Iterator[None]:
    """Convert any exception of a tracker to TrackerError."""
    try:
        yield
    except TrackerError:
        raise
    except Exception as error:
        raise TrackerError(f"mlflow: {message_of(error)}") from error


def _database(uri: str) -> Path | None:
    """File of a SQLite URI; None for other URIs."""
    if not uri.startswith("sqlite:"):
        return None
    path = Path(uri.removeprefix("sqlite:///")).absolute()
    if not uri.startswith("sqlite:///") or "?" in uri:
        raise ConfigError(f"uri: is {uri!r}; expected sqlite:///PATH without '?' in it")
    return path


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(path, timeout=LOCK_SECONDS):
            yield
    except Timeout:
        raise TrackerError(
            f"{path}: another process has held it for {LOCK_SECONDS:.0f} s"
        ) from None


def _digest(run: Any) -> str:
    """Digest of a run that was written completely; empty for others."""
    complete = run.info.status == "FINISHED"
    return str(run.data.tags.get("miho.digest", "")) if complete else ""


def numbers_of(stored: StoredRun) -> dict[str, float]:
    """Results that MLflow stores in addition to the curve, without non-finite values.

    `error` is the root of the loss in the unit of the problem; times are in seconds.
    """
    result = stored.result
    spent = ("evaluations", "seconds", "cpu_seconds", "setup_seconds")
    numbers = {"error": error_of(result["loss"]), **{key: float(result[key]) for key in spent}}
    theta = result["theta"] or [math.nan] * len(result["parameters"])
    for parameter, value in zip(result["parameters"], theta, strict=True):
        numbers[word(f"theta.{parameter['name']}")] = float(value)
    return {key: value for key, value in numbers.items() if math.isfinite(value)}


def word(name: str) -> str:
    """Name that MLflow accepts, of letters, digits, '_', '-', '.' and spaces."""
    return re.sub(r"[^\w.\- ]", "_", name, flags=re.ASCII)[:250]


def _milliseconds(environment: Mapping[str, Any]) -> int:
    """Start of a run from its stamp, in milliseconds since 1970; 1 without a stamp."""
    try:
        start = datetime.datetime.fromisoformat(environment["time"]).timestamp()
    except (LookupError, TypeError, ValueError):
        return 1
    return max(1, round(1000 * start))


def _settings(config: Mapping[str, Any]) -> dict[str, str]:
    """Settings by dotted name; values too long for MLflow are only in config.json."""
    texts = {
        word(name): value if isinstance(value, str) else json.dumps(value)
        for name, value in flattened(config).items()
    }
    return {name: text for name, text in texts.items() if len(text) <= LONGEST_PARAM}


def _curve(stored: StoredRun) -> dict[str, list[float]]:
    """Evaluations, seconds and error at each improvement and at the end."""
    times = {name: stored.curve[name] for name in ("evaluations", "seconds", "cpu_seconds")}
    return {**times, "error": [error_of(loss) for loss in stored.curve["loss"]]}


def _points(stored: StoredRun, start: int) -> list[tuple[str, float, int, int]]:
    """Name, value, timestamp and step of each metric; one point of the curve per evaluation."""
    numbers = numbers_of(stored)
    last, seconds = math.ceil(numbers["evaluations"]), numbers["seconds"]
    curve = _curve(stored)
    rows = zip(curve["evaluations"], curve["seconds"], curve["error"], strict=True)
    at = {math.ceil(evaluations): (second, error) for evaluations, second, error in rows}
    at[last] = seconds, numbers.get("error", math.nan)
    points = [
        (name, value, start + round(1000 * second), step)
        for step, (second, error) in sorted(at.items())
        for name, value in (("error", error), ("seconds", second))
        if math.isfinite(value)
    ]
    scalars = (name for name in numbers if name not in ("error", "seconds"))
    return points + [(name, numbers[name], start + round(1000 * seconds), last) for name in scalars]
