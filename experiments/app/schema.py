"""The schema of configurations: all keys with their types and defaults."""

import math
from dataclasses import dataclass, field
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING


@dataclass
class ParameterConfig:
    """One parameter of the space; the fields of `miho.Parameter` without the name.

    `scaled` gives bounds in multiples of the largest magnitude of a column of the data, for example
    {by: alpha, low: -0.5, high: 0.5}; `by: output` is the column of the measured output. An
    explicit value, such as space.D.high=8000, replaces the scaled one. `fixed` is a constant value,
    `tied` an expression of other parameters, such as '1 - a - b'. `prior` is the mean and the
    standard deviation of a normal prior.
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
    """The fields of `miho.Budget`; Hydra cannot fill that class because it is frozen."""

    evaluations: int | None = None
    seconds: float | None = None
    target: float | None = None


@dataclass
class PartConfig:
    """One part of a joint problem: its changes of `dataset` and `model`, and its `sigma`.

    A `dataset` or `model` with a `_target_` replaces the node of the configuration; without one, it
    replaces some settings. If neither the part nor `problem` has `sigma`, it is estimated.
    """

    dataset: dict[str, Any] = field(default_factory=dict)
    model: dict[str, Any] = field(default_factory=dict)
    sigma: Any = None


@dataclass
class ProblemConfig:
    """Facts about a problem: its name (default: names of model and data) and its optimum.

    The problems of a `family` (default: the problem alone) share a model and a kind of box, or a
    published formula. Their results are not independent, so ranks and tests are also shown over
    families. `optimum` is the smallest known root of the loss in the space, in the unit of the
    output, and `evidence` explains it. If the data have no errors, errors below `resolution` are
    rounding and count as equal to it in an arena. `sigma` is the standard deviation of the errors,
    a number or a column of the dataset; with `sigma_known=false` it is known only up to a factor.

    `parts` are several datasets or outputs that are identified at once. They share the parameters
    of equal names, except the parameters in `local`, which become NAME_PART in each part.
    `constraints` between parameters are linear, such as ['a < b', 'a + b = 1'].
    """

    name: str | None = None
    family: str | None = None
    optimum: float | None = None
    resolution: float | None = None
    evidence: str = ""
    sigma: Any = None
    sigma_known: bool = True
    parts: dict[str, PartConfig] = field(default_factory=dict)
    local: list[str] = field(default_factory=list)
    constraints: Any = None


@dataclass
class ComparisonConfig:
    """The methods and problems of a comparison, the number of repetitions, and the output.

    `methods` maps options of conf/optimizer to settings that replace their defaults. `problems`
    names several options of conf/problem, also by patterns such as nist_*, for an arena; without it
    there is one problem. In an arena, a run ends at `target` times the recorded optimum of its
    problem. `note` is text for the figures. Figures and tables are written to `output`.
    """

    repetitions: int = 5
    target: float | None = None
    problems: list[str] = field(default_factory=list)
    methods: dict[str, dict[str, Any]] = field(default_factory=dict)
    note: str = ""
    output: str = "${root}/figures"


@dataclass
class SweepConfig:
    """How a sweep (-m) or an arena executes its runs.

    `workers` is the number of simultaneous runs, in processes of this machine, or the address of a
    cluster, one run per thread: dask://HOST:PORT, dask:N, slurm:N, pbs:N or lsf:N. With `shared`,
    the workers of a cluster see `root` and the user's files at the same paths as this machine and
    store their runs themselves; otherwise results are sent to this machine and stored here. A run
    that takes longer than `time_limit` seconds is killed. A run that fails or is lost stops the
    others only with `stop_on_failure`; the next call repeats it. `dry_run` only lists the runs.
    `timed` means that seconds are compared: `fresh` then also sets aside finished runs whose
    seconds other work disturbed.
    """

    workers: Any = 1
    shared: bool = False
    time_limit: float | None = None
    stop_on_failure: bool = False
    dry_run: bool = False
    timed: bool = False


@dataclass
class TrackingConfig:
    """Tracker to which finished runs are copied; see conf/tracking."""

    tracker: str | None = None
    uri: str | None = None
    experiment: str | None = None


@dataclass
class ObstacleConfig:
    """An obstacle: a box on the driven line; all lengths are in metres.

    `s` is its position along the line, `e` its offset to the left, and `sight` the distance from
    which it is seen; without `sight` there is no obstacle. The path around it leaves the line at
    most `out` before the box and returns to the line within `back` after it.
    """

    s: float = 0.0
    e: float = 0.0
    length: float = 5.0
    width: float = 2.0
    sight: float | None = None
    out: float = 80.0
    back: float = 120.0


@dataclass
class SlowZoneConfig:
    """Top speed [m/s] between `start` and `end` [m], the distance along the line over all laps."""

    start: float = 0.0
    end: float = math.inf
    top_speed: float = 0.0


@dataclass
class DriveConfig:
    """A simulated drive in closed loop; see conf/track, conf/vehicle and conf/controller.

    known: parameters that planner and controllers use, `identified` from the embedded data by the
    optimizer, or the `truth`; `parameters` names parameters.json files of parts that were
    identified before. sensitivity [-]: relative change of a tire's friction per relative change of
    its load; null takes it from the property data. performance_factor: share of the known grip of
    the tires that the plan uses (the paper's mu). road_friction: friction of the simulated road,
    relative to the road on which the tires were measured; the plan does not know it. reserve: share
    of the planned grip that the planned speeds leave to the controllers. The car starts at the arc
    length `start` [m] of the line with `speed` [m/s] and drives `distance` [m]. `top_speeds` [m/s]
    are the top speeds of the laps in order, lower in the `slow` zones; the desired speed rises by
    `ramp` and falls by `brake_ramp` [m/s^2]. Without them, only the plan's `top_speed` applies.
    equations: `corrected`, or Eq. 10-15 as `printed`; `printed_plan` and `printed_steering` use one
    part of them as printed. Log, figure and table are written to `output`, identified parts to
    `root`.
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
class OnlineConfig:
    """How a stream of rows is tracked, in SI units; see conf/tracker and conf/stream.

    learn: time [s] from the beginning of a replayed dataset whose rows are the offline data;
    without it, the whole dataset is. changes: parameters that may jump, with the share of their
    value; the alarm watches them, and `names` has their names in its words. input_noise: standard
    deviations of the noise of input columns. period: time between rows without a column `time` [s].
    resume: continue with the state that a session left in `root`. live: show the states in the
    terminal, if stdout is one.
    """

    learn: float | None = None
    changes: dict[str, float] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    input_noise: dict[str, float] = field(default_factory=dict)
    period: float = 0.02
    resume: bool = False
    live: bool = True


@dataclass
class Config:
    """One run, or with `comparison` a set of runs.

    `fresh` sets aside finished runs of the same request that used other code, data, settings or
    packages; without it, the command refuses to mix old and new runs.

    `method` is the name of the method in the results; by default, the name of the option of
    `optimizer` (of `r500/miho`: miho).

    `workers` make the evaluations of a run if each is expensive: a number of processes, -1 for one
    per core, or the address of a cluster; in a sweep, each run has this number. An evaluation is
    given up after `evaluation_limit` seconds. The identity of a run depends on neither.
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
    tracker: dict[str, Any] = field(default_factory=dict)
    stream: dict[str, Any] = field(default_factory=dict)
    online: OnlineConfig = field(default_factory=OnlineConfig)


RENAMED = {
    "drive.mu": "is now two settings: drive.performance_factor, the share of the tires' grip that "
    "the plan uses (the paper's mu), and drive.road_friction, the friction of the road",
    "optimizer=miho_asynchronous": "was removed; use miho_gn_asynchronous, or miho with workers",
    "optimizer=readings/": "was removed; give the settings of the reading, as in optimizer=pso_100 "
    "optimizer.velocity_limit=null method=NAME; VARIANTS in experiments/check/readings.py has them",
    "miho.optim.AsynchronousMIHO": "was removed; use miho.optim.AsynchronousMIHOGN, or "
    "miho.optim.MIHO with workers",
    "sweep.processes": "is now sweep.workers",
    "comparison.processes": "is now sweep.workers",
    "problem.compressed": "was removed, because losses are summed over all rows; leave it out",
    "problem.threads": "was removed; a loss has one thread, and sweep.workers makes several runs",
}
"""Messages on settings, options and classes that were renamed or removed, by former name; of a
removed folder of options, by its name with a slash."""

ConfigStore.instance().store(name="schema", node=Config)
