"""The typed root of every configuration: what it may hold, and of what type."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING


@dataclass
class ParameterConfig:
    """One parameter of the space; the fields of `miho.Parameter` without the name.

    `scaled` gives some of them in multiples of the largest magnitude of a column of the data:
    {by: alpha, low: -0.5, high: 0.5}, where `by: output` is the column to be explained. A value
    that stands beside it, such as space.D.high=8000, counts instead. `fixed` holds the parameter
    at a number, `tied` at an expression of others, such as '1 - a - b'; `prior` is the mean and the
    standard deviation of what is known of it besides the data.
    """

    unit: str = MISSING
    low: float = MISSING
    high: float = MISSING
    scale: str = "linear"
    mean: float | None = None
    std: float | None = None
    sigma_max: float | None = None
    sigma_min: float = 0.0
    fixed: float | None = None
    tied: str | None = None
    prior: Any = None
    scaled: dict[str, Any] | None = None


@dataclass
class BudgetConfig:
    """The fields of `miho.Budget`, which Hydra could not fill because it is frozen."""

    evaluations: int | None = None
    seconds: float | None = None
    target: float | None = None


@dataclass
class PartConfig:
    """One part of a joint problem: what differs from `dataset` and `model`, and its `sigma`.

    A `dataset` or `model` with a `_target_` replaces the one of the whole configuration, another
    one some of its settings. Without `sigma`, here and in `problem`, it is estimated.
    """

    dataset: dict[str, Any] = field(default_factory=dict)
    model: dict[str, Any] = field(default_factory=dict)
    sigma: Any = None


@dataclass
class ProblemConfig:
    """What is known of a problem: its name, if not that of model and data, and its best error.

    Problems of one `family` (default: each is its own) are one model in one kind of box, or one
    published formula in any box: their outcomes are not independent, so ranks and tests are shown
    over families as well. `optimum` is the smallest known root of the loss in the space, in the
    output's unit, and `evidence` says how it is known. Of data without errors, an error below
    `resolution` is rounding, and counts as equal to it in an arena. `threads` are those of
    `miho.CurveFit`: they make losses faster, which methods that work with residuals (`miho_gn`,
    least squares) do not ask for. `sigma` is the standard deviation of the errors, a
    number or a column of the dataset, known as it is or up to a factor (`sigma_known`).

    `parts` are several datasets or outputs, identified at once: parameters of one name are one, but
    those in `local`, of which each part has its own, NAME_PART. `constraints` between
    parameters are linear, such as ['a < b', 'a + b = 1'].
    """

    name: str | None = None
    family: str | None = None
    optimum: float | None = None
    resolution: float | None = None
    evidence: str = ""
    threads: int = 1
    sigma: Any = None
    sigma_known: bool = True
    parts: dict[str, PartConfig] = field(default_factory=dict)
    local: list[str] = field(default_factory=list)
    constraints: Any = None


@dataclass
class ComparisonConfig:
    """Which methods to compare, how often, and what to write on the figure.

    `methods` maps an optimizer of conf/optimizer to settings that replace its own. `problems` names
    several of conf/problem, which are then compared on together, `processes` runs at a time;
    without it there is one problem, and one run at a time. With several, runs end at `target` times
    the optimum that their problem records: what comes after that is compared by nothing. Figures
    and tables go to `output`.
    """

    repetitions: int = 5
    target: float | None = None
    problems: list[str] = field(default_factory=list)
    processes: int = 1
    methods: dict[str, dict[str, Any]] = field(default_factory=dict)
    note: str = ""
    output: str = "${root}/figures"


@dataclass
class SweepConfig:
    """How a sweep (-m) goes through its runs.

    `workers` runs at a time, in processes of this machine, or as many as a cluster has threads:
    dask://HOST:PORT, dask:N, slurm:N, pbs:N or lsf:N (`processes` is the former name). With
    `shared` the workers of a cluster see `root` and the user's files at the same paths as this
    machine, and store what they do by themselves; else it is sent here and stored here. A run that
    takes longer than `time_limit` seconds in all is killed. A run that fails or is lost stops no
    other, unless `stop_on_failure`; the next call does it again. `dry_run` lists the runs and does
    none. `timed` says that seconds are compared: `fresh` then also sets aside finished runs whose
    seconds other work disturbed.
    """

    workers: Any = 1
    processes: int | None = None
    shared: bool = False
    time_limit: float | None = None
    stop_on_failure: bool = False
    dry_run: bool = False
    timed: bool = False


@dataclass
class TrackingConfig:
    """Where finished runs are mirrored to; see conf/tracking."""

    tracker: str | None = None
    uri: str | None = None
    experiment: str | None = None


@dataclass
class ObstacleConfig:
    """A box on the line that is driven: s along it, e to its left, sides [m]; and from how far
    before it is seen [m]. Without `sight` there is none. The path around it leaves the line over
    the last `out` [m] before it at most, and returns over `back` [m] behind it."""

    s: float = 0.0
    e: float = 0.0
    length: float = 5.0
    width: float = 2.0
    sight: float | None = None
    out: float = 80.0
    back: float = 120.0


@dataclass
class SlowZoneConfig:
    """From `start` to `end` [m] along the line, laps added up, with a top speed [m/s]."""

    start: float = 0.0
    end: float = math.inf
    top_speed: float = 0.0


@dataclass
class DriveConfig:
    """A drive in closed loop; see conf/track, conf/vehicle and conf/controller.

    known: what planner and controllers know of the car, `identified` from the embedded data by the
    optimizer or the `truth`; `parameters` names parameters.json files of parts of it that
    were identified before. sensitivity [-]: how far the tires' forces fall behind their loads; null
    takes it from the property data. performance_factor: the share of the tires' grip, as it is
    known, that the plan uses (the paper's mu). road_friction: what the road gives the simulated
    car, over the road on which its tires were measured; the plan does not know it. reserve: the
    share of the planned grip that the speeds leave to the controllers. The car starts at the arc
    length `start` [m] of the line with `speed` [m/s] and drives a distance [m]. `top_speeds` [m/s]
    of the laps in turn, less in the `slow` zones; the desired speed goes from one to the next by
    `ramp` upwards and `brake_ramp` downwards [m/s^2]. Without them only the plan's `top_speed`
    counts. equations: `corrected`, or Eq. 10-15 as they are `printed`; `printed_plan` and
    `printed_steering` take one part of them. Log, figure and table go to `output`, identified parts
    to `root`.
    """

    vehicle: dict[str, Any] = field(default_factory=dict)
    track: dict[str, Any] = field(default_factory=dict)
    controller: dict[str, Any] = field(default_factory=dict)
    known: str = "identified"
    equations: str = "corrected"
    parameters: dict[str, str] = field(default_factory=dict)
    sensitivity: float | None = None
    noise: bool = True
    performance_factor: float = 1.0
    road_friction: float = 1.0
    reserve: float = 0.0
    top_speed: float = 90.0
    top_speeds: list[float] = field(default_factory=list)
    ramp: float = 1.5
    brake_ramp: float = 1.5
    slow: list[SlowZoneConfig] = field(default_factory=list)
    start: float = 0.0
    speed: float = 30.0
    distance: float = 0.0
    figure: str = "fig8"
    obstacle: ObstacleConfig = field(default_factory=ObstacleConfig)
    output: str = "${root}"


@dataclass
class Config:
    """One run, or with `comparison` a set of runs of the same problem.

    `fresh` sets aside finished runs of the same request that were made of other code, data,
    settings or packages, where the program else refuses to mix old and new.

    `method` is the name of the method in the results; without it, the name of the option that was
    chosen for `optimizer` (of `small/miho`: miho).

    `workers` make the evaluations of a run where each takes long: a number of processes, -1 for one
    per core, or the address of a cluster; in a sweep those of each run. An evaluation that takes
    longer than `evaluation_limit` seconds is given up. What a run is does not depend on either.
    """

    model: dict[str, Any] = MISSING
    dataset: dict[str, Any] = MISSING
    space: dict[str, ParameterConfig] = field(default_factory=dict)
    loss: dict[str, Any] = MISSING
    problem: ProblemConfig = field(default_factory=ProblemConfig)
    optimizer: dict[str, Any] = MISSING
    method: str | None = None
    budget: BudgetConfig = field(default_factory=BudgetConfig)
    seed: int = 0
    workers: Any = 1
    evaluation_limit: float | None = None
    root: str = "runs/identify"
    fresh: bool = False
    sweep: SweepConfig = field(default_factory=SweepConfig)
    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    comparison: ComparisonConfig = field(default_factory=ComparisonConfig)
    drive: DriveConfig = field(default_factory=DriveConfig)


RENAMED = {
    "drive.mu": "is now two settings: drive.performance_factor, the share of the tires' grip that "
    "the plan uses (the paper's mu), and drive.road_friction, what the road gives the car",
    "problem.compressed": "is gone, since losses are summed over all rows; leave it out",
}
"""What became of settings that are called otherwise, or are gone."""


def register() -> None:
    """Make the schema known to Hydra under the name `schema`."""
    ConfigStore.instance().store(name="schema", node=Config)
