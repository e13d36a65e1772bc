"""The commands, as a user types them: results, one-line errors, exit codes, nothing left behind."""

import json
import math
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lsim

from experiments import compare as comparing
from experiments import figures
from experiments import identify as identifying
from experiments.app.build import rebuild
from experiments.app.execution import result_line
from miho import load_runs
from miho.parallel.usage import Usage
from miho.study import Status
from miho.study.manifest import sweep_commands
from miho.study.store import read_run
from tests.faults.misbehaviour import MODEL

ROOT = Path(__file__).parent.parent
TIRE = ROOT / "miho" / "vehicle" / "data" / "tires" / "lf.tir"
QUICK = ["optimizer=least_squares", "dataset.n=200"]

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def identify(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Command:
    """Run `experiments.identify` in this process: exit code, standard output and error."""
    return _command(monkeypatch, capsys, tmp_path, identifying.main)


@pytest.fixture
def compare(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Command:
    """The same for `experiments.compare`."""
    return _command(monkeypatch, capsys, tmp_path, comparing.main)


def _command(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    main: Callable[[], None],
) -> Command:
    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["command", *arguments, f"root={tmp_path / 'runs'}"])
        with pytest.raises(SystemExit) as end:
            main()
        return (int(end.value.code or 0), *capsys.readouterr())

    return run


def test_identify_marks_a_parameter_at_its_bound(identify: Command) -> None:
    code, out, _ = identify(*QUICK, "space.D.high=2000")
    assert code == 0
    assert re.search(r"limits +D = 2000 N \(at its upper bound\)", out)
    code, out, _ = identify(*QUICK)
    assert "limits" not in out


def test_identify_prints_parameters_errors_and_evidence(identify: Command, tmp_path: Path) -> None:
    code, out, _ = identify(*QUICK)
    assert code == 0
    for word in ("1/rad", "195 degrees of freedom", "irreducible", "evaluations", "(ran)"):
        assert word in out
    assert re.search(r"optimum +In doubt: only \d+ of 30 descents", out)
    assert "best known" not in out, "nothing was recorded, and nothing else is run to know it"
    assert len(load_runs(tmp_path / "runs").runs) == 1
    assert re.search(r"^workers +evaluations made here, [\d.]+ .s each$", out, re.MULTILINE)
    again = identify(*QUICK)[1]
    assert "(done before)" in again
    assert re.findall("^workers .*", again, re.MULTILINE) == re.findall("^workers .*", out, re.M)


def test_the_line_of_a_run_says_what_its_workers_did() -> None:
    identity: Any = SimpleNamespace(problem="tire", optimizer="miho_gn_asynchronous", seed=0)
    usage = Usage(32, here=9, each=1e-6, at_a_time=1).stored
    result = {"loss": 4.0, "facts": {"unit": "N"}, "rejected": {}, "evaluations": 9, "seconds": 0.5}
    line = "tire miho_gn_asynchronous seed 0: 2 N, 9 evaluations, 0.50 s (ran)"
    said = "; evaluations made here, 1 µs each: too short for 32 workers, so one at a time"
    assert result_line(identity, result | {"usage": usage}, Status.RAN) == line + said
    # One process needs no remark, and runs that were stored before have none.
    alone = Usage(1, here=9, each=1e-6).stored
    for others in ({"usage": alone}, {"usage": None}, {}):
        assert result_line(identity, result | others, Status.RAN) == line


def test_a_budget_that_buys_no_value_says_what_to_do(identify: Command) -> None:
    code, out, _ = identify("optimizer=miho_gn", "budget.evaluations=2", "budget.seconds=null")
    assert code == 0
    assert "miho_gn seed 0: no value on all rows of data, 2 evaluations" in out
    assert "search again with a larger one: budget.evaluations=20" in out
    assert "no finite value" not in out


@pytest.mark.slow
def test_a_method_that_leaves_the_box_is_remarked(identify: Command) -> None:
    """The authors' code clips at lower bounds only, and so does this choice."""
    small = ["optimizer.R=300", "dataset.n=200", "budget.evaluations=3000"]
    out = identify("optimizer=miho_reference", *small)[1]
    assert re.search(r"evaluations, at least \d+ of them outside the box", out)
    assert re.search(r"^outside +at least \d+ evaluations", out, re.MULTILINE)
    assert "outside" not in identify("optimizer=miho", *small)[1]


@pytest.mark.slow
def test_a_second_sweep_runs_nothing(identify: Command, tmp_path: Path) -> None:
    sweep = ["-m", "optimizer=least_squares,random", "seed=range(3)", "dataset.n=100"]
    code, out, _ = identify(*sweep, "budget.evaluations=2000")
    assert (code, out.splitlines()[-1]) == (0, "6 runs: 6 ran")
    code, out, _ = identify(*sweep, "budget.evaluations=2000")
    assert (code, out.splitlines()[-1]) == (0, "6 runs: 6 done before")
    assert len(load_runs(tmp_path / "runs").runs) == 6


def text_cell(tmp_path: Path) -> list[str]:
    path = tmp_path / "cell.csv"
    path.write_text("alpha,Fy\n0.1,-200\n0.2,many\n")
    return ["dataset=csv", f"dataset.path={path}"]


def other_header(tmp_path: Path) -> list[str]:
    path = tmp_path / "other.csv"
    path.write_text("Schräglauf,Querkraft\n0.1,-200\n0.2,-300\n", encoding="utf-8")
    return ["dataset=csv", f"dataset.path={path}"]


def missing_coefficient(tmp_path: Path) -> list[str]:
    path = tmp_path / "tire.tir"
    lines = TIRE.read_text(encoding="latin-1").splitlines(keepends=True)
    path.write_text("".join(line for line in lines if not line.startswith("PKY1 ")))
    return ["dataset=tir", f"dataset.tire={path}"]


def option_of_a_known_name(tmp_path: Path) -> list[str]:
    path = tmp_path / "optimizer" / "miho.yaml"
    path.parent.mkdir()
    path.write_text((ROOT / "conf" / "optimizer" / "miho.yaml").read_text().replace("5", "4"))
    return ["optimizer=miho", f"--config-dir={tmp_path}"]


BAD: dict[str, tuple[list[str] | Callable[[Path], list[str]], str]] = {
    "unknown optimizer": (
        ["optimizer=foo"],
        "optimizer=foo: is unknown; allowed are cluster_gauss_newton, cma_es",
    ),
    "R = 0": (["optimizer=miho", "optimizer.R=0"], "R is 0; expected a whole number of at least 1"),
    "R is a word": (
        ["optimizer=miho", "optimizer.R=many"],
        "optimizer.R: is 'many'; expected a value of type int",
    ),
    "low > high": (["space.B.low=300"], "'B': low is 300.0 and high is 200.0"),
    "unknown setting": (["optimizer.alpha=1"], "optimizer.alpha: is unknown; allowed are"),
    "unknown key": (["xyz=1"], "xyz: is unknown; allowed are model, dataset, space"),
    "a setting without its group": (
        ["seconds=3"],
        "seconds: is unknown; did you mean budget.seconds?",
    ),
    "unknown in space": (["space.B.lo=1"], "did you mean low? allowed are unit, low"),
    "wrong type": (["space.B.low=wide"], "space.B.low: is 'wide'; expected a number"),
    "half an evaluation": (
        ["budget.evaluations=1.5"],
        "budget.evaluations: is 1.5; expected a whole number",
    ),
    "evaluations as a power of ten": (
        ["budget.evaluations=1e3"],
        "budget.evaluations: is 1000.0; expected a whole number, written 1000\n",
    ),
    "no evaluation": (["budget.evaluations=0"], "budget.evaluations is 0"),
    "negative seed": (["seed=-1"], "seed: is -1"),
    "a foreign target": (["model._target_=os.system"], "model._target_: 'os.system' is not"),
    "a target behind ours": (["model._target_=miho.study.files.os.system"], "is not a class or"),
    "a target of another kind": (["model._target_=miho.optim.MIHO"], "that gives a Model"),
    "a private target": (["dataset._target_=miho.data.csv._number"], "that gives a Dataset"),
    "an unknown key, added": (["+sed=1"], "sed: is unknown; did you mean seed? allowed are model"),
    "an unknown limit, added": (["+budget.second=1"], "budget.second: is unknown; did you"),
    "an unknown bound, added": (["++space.B.lo=1"], "space.B.lo: is unknown; did you mean low?"),
    "a range without end": (
        ["space.B.sigma_max=inf"],
        "'B': sigma_min is 0.0 and sigma_max is inf",
    ),
    "a range too wide": (["space.B.low=-1e308", "space.B.high=1e308"], "finite bounds"),
    "no ranges": (["dataset=tir", f"dataset.tire={TIRE}", "dataset.ranges=5"], "ranges is 5"),
    "too many rows": (["dataset.n=10000000000000"], "dataset: is too large for the memory"),
    "too large a bracket": (["optimizer=miho", "optimizer.R=1000000000000"], "at most 10,000,000"),
    "too large a swarm": (
        ["optimizer=pso_100", "optimizer.particles=1000000000"],
        "at most 10,000",
    ),
    "a device": (["dataset=csv", "dataset.path=/dev/zero"], "is not a file"),
    "the wrong unit": (
        ["dataset=csv", f"dataset.path={ROOT / 'LICENSE'}"],
        "LICENSE:1:1: no column 'alpha'",
    ),
    "a bad seed in a sweep": (["-m", "dataset.n=10", "seed=0,-1"], "seed: is -1"),
    "no path given": (["dataset=csv"], "dataset.path: is missing; give it on the command line"),
    "no such file": (["dataset=csv", "dataset.path=no/such.csv"], "no/such.csv: No such file"),
    "not a tire": (["dataset.tire=xx"], "xx:1:1: there is no such file"),
    "no key": (["=3"], "=3: has no key; write KEY=VALUE"),
    "a bad choice in a sweep": (
        ["-m", "optimizer=random,foo", "dataset.n=10"],
        "optimizer=foo: is unknown",
    ),
    "a word like another": (["sede=1"], "sede: is unknown; did you mean seed?"),
    "a choice like another": (["optimizer=mhio"], "optimizer=mhio: is unknown; did you mean miho?"),
    "a choice of very many": (
        ["problem=nist_mgh9"],
        "problem=nist_mgh9: is unknown; the closest of ",
    ),
    "a removed folder of choices": (
        ["optimizer=readings/pso_100_no_limit"],
        "as in optimizer=pso_100 optimizer.velocity_limit=null method=NAME; VARIANTS in",
    ),
    "the same in a sweep": (
        ["-m", "optimizer=random,readings/pso_100_no_limit"],
        "optimizer=readings/pso_100_no_limit: was removed; give the settings",
    ),
    "a choice in a folder": (["optimizer=r500/mio"], "error: optimizer=r500/mio: is unknown;"),
    "a group like another": (["optimiser=miho"], "did you mean optimizer?"),
    "a setting of another choice": (
        ["dataset.path=my.csv"],
        "path is a setting of dataset=axle_log, dataset=brake_log, dataset=csv",
    ),
    "a group below a problem": (
        ["problem=nist_misra1a_log", "problem.space.b1.high=5"],
        "evidence, sigma, sigma_known, parts, local, constraints\n",
    ),
    "an unknown fact of a problem": (["+problem.foo=1"], "problem.foo: is unknown; allowed are"),
    "a name inside a parameter": (["+space.B.name=q"], "space.B.name: is unknown"),
    "an own meaning of a parameter": (["+space.B.stands_for=q"], "space.B.stands_for: is unknown"),
    "a trailing comma": (["seed=1,"], "seed=1,: ends with a comma; remove it"),
    "a seed that is no whole number": (["seed=1.5"], "seed: is 1.5; expected a whole number"),
    "several values without -m": (["seed=1,2"], "To sweep over it, add --multirun"),
    "no values": (["-m", "seed=range(0)"], "-m: has no values to sweep over"),
    "no override": (["my.csv"], "my.csv: is not a setting; write KEY=VALUE"),
    "a parameter added for nothing": (
        ["+space.a={unit: V, low: 1, high: 3}"],
        "needs the parameters B, C, D, Sx, Sy; the space also has a",
    ),
    "a parameter added in part": (["+space.a.low=1"], "space.a.unit: is missing"),
    "nothing for a choice": (
        ["space=null"],
        "space=null: is not an option; ~space removes the group",
    ),
    "a list for a choice": (
        ["dataset=[tire_lf,tire_rf]"],
        "is a list; choose one option, or sweep: -m dataset=tire_lf,tire_rf",
    ),
    "a list in a sweep": (["-m", "dataset=[tire_lf,tire_rf],tire_rr"], "is a list; choose one"),
    "a number with decimals in a sweep": (["-m", "seed=1.0,2"], "seed: is '1.0,2'; expected a who"),
    "a number for a choice": (["budget=5"], "budget=5: is unknown; allowed are default"),
    "a shell's brackets": (
        ["dataset.units={a: m/s^2}"],
        "quote the whole override",
    ),
    "letters that are to be quoted": (
        ["dataset.headers=[Schräglauf]"],
        """quote names with other characters, as in 'dataset.headers=["m/s^2", "Schräglauf"]'""",
    ),
    "letters that cannot be quoted": (
        ["dataset.where={Schräglauf: [0, 1]}"],
        "put those into a file for --config-dir",
    ),
    "a column of another name": (
        other_header,
        "give the names in the file in the same order: headers=[...]",
    ),
    "a space that is incomplete": (
        ["space={B: {unit: 1/rad, low: 1}}"],
        "space.B.high: is missing",
    ),
    "a cycle": (["space.C.tied=1 + C"], "space.C.tied: C -> C is a cycle"),
    "code for an expression": (["space.C.tied=B.real"], "'B.real' is not allowed; use numbers"),
    "an unknown name in it": (["space.C.tied=1 + Bq"], "unknown parameter Bq; did you mean B?"),
    "an empty set": (
        ["space.C.tied=1 + B", "space.C.low=500", "space.C.high=600"],
        "'1 + B' is 1.05 to 200.9 in the box of the other parameters; expected values from 500",
    ),
    "fixed to nothing": (["space.C.fixed=nan"], "'C': fixed is nan; expected a finite number"),
    "fixed to a word": (["space.C.fixed=one"], "space.C.fixed: is 'one'; expected a number"),
    "fixed and tied": (["space.C.fixed=1", "space.C.tied=B"], "is fixed to 1.0 and tied to 'B'"),
    "all fixed": (
        [f"space.{name}.fixed={at}" for name, at in zip("BCD", (1, 1, 4000), strict=True)]
        + ["space.Sx.fixed=0", "space.Sy.fixed=0"],
        "every parameter of the space is fixed or tied",
    ),
    "no such sigma": (["problem.sigma=noise"], "no column 'noise'"),
    "a sigma below 0": (["problem.sigma=-1"], "sigma is -1; expected a number above 0"),
    "a prior without sigma": (["space.B.prior=[10, 1]"], "space.B.prior: expected a known sigma"),
    "half a prior": (["space.B.prior=[10]", "problem.sigma=1"], "expected mean and standard devi"),
    "a prior that is no number": (
        ["space.B.prior=[10, x]", "problem.sigma=1"],
        "prior is [10, 'x']; expected mean and standard deviation",
    ),
    "a prior that is a word": (["space.B.prior=x", "problem.sigma=1"], "prior is 'x'; expected"),
    "a prior far away": (
        ["space.B.prior=[-100, 1]", "problem.sigma=1"],
        "prior is [-100, 1], 100 deviations outside of 0 to 200",
    ),
    "a constraint that nothing keeps": (
        ["problem.constraints=['B < -1']"],
        "no values of B from 0 to 200 satisfy B < -1",
    ),
    "a constraint of others": (
        ["problem.constraints=['B < Q']"],
        "'Q' uses an unknown parameter Q",
    ),
    "a number for a constraint": (["problem.constraints=5"], "constraints: expected linear relat"),
    "an option of a known name": (option_of_a_known_name, "miho.yaml is not read, because conf/"),
    "two folders of options": (
        ["--config-dir=a", "-cd", "b"],
        "--config-dir: is given 2 times, and Hydra reads one folder",
    ),
    "no such folder": (["--config-dir", "no/such"], "--config-dir: no/such is not a folder"),
    "a bad value in a sweep": (["-m", "dataset.n=10,0"], "at least one sample"),
    "a .tir without a coefficient": (missing_coefficient, "PKY1"),
    "a CSV with a text cell": (text_cell, "cell.csv:3:5: 'many' in column 'Fy'"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_leaves_nothing(
    identify: Command, tmp_path: Path, case: str
) -> None:
    given, message = BAD[case]
    arguments = given if isinstance(given, list) else given(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    code, out, err = identify(*arguments, "hydra.output_subdir=null")
    assert code == 2
    assert out == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert message in err
    # Hydra makes the folder of its job before the task is called.
    left = {path for path in tmp_path.rglob("*") if path.is_file() and path.name != "multirun.yaml"}
    assert left == {path for path in before if path.is_file()}


MINE = """\
# @package _global_
# Mine.
defaults: [override /model: function, override /dataset: csv, override /space: null]
model: {{path: {folder}/decay.py}}
dataset: {{path: {folder}/my.csv, columns: [t, y], units: [s, V], output: y}}
space: {{a: {{unit: V, low: 0, high: 5}}, b: {{unit: 1/s, low: 0.01, high: 10, scale: log}}}}
"""
DECAY = """\
import numpy as np
def decay(t: "s", *, a: "V", b: "1/s") -> "V":
    return a * np.exp(-b * t)
"""


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A folder of options with an experiment of one's own, its model and its data beside it."""
    folder = tmp_path / "own options"
    (folder / "experiment").mkdir(parents=True)
    (folder / "experiment" / "mine.yaml").write_text(MINE.format(folder=folder))
    (folder / "decay.py").write_text(DECAY)
    rows = (
        f"{t},{2 * math.exp(-1.5 * t) + 0.05 * math.cos(40 * t)}" for t in np.linspace(0, 2, 20)
    )
    (folder / "my.csv").write_text("\n".join(["t,y", *rows]) + "\n")
    return folder


ENDS = """\
class Odd(BaseException):
    pass
{early}
calls = 0
def line(alpha: "rad", *, B: "1/rad", C: "-", D: "N", Sx: "rad", Sy: "N") -> "N":
    global calls
    calls += 1
    if alpha.size and calls > {after}:
        {late}
    return Sy - B * D * (alpha - Sx)
"""


@pytest.mark.parametrize("deed", ["raise KeyboardInterrupt", "raise Odd('no')", "raise SystemExit"])
@pytest.mark.parametrize("when", ["import", "first call", "run"])
def test_what_a_model_raises_by_itself_is_a_failure(
    identify: Command, tmp_path: Path, deed: str, when: str
) -> None:
    """It is no interrupt, and a model that leaves has not succeeded: one line, with the file."""
    model = tmp_path / "model.py"
    early, late = (deed, "pass") if when == "import" else ("", deed)
    after = 100 if when == "run" else 0
    model.write_text(ENDS.format(early=early, late=late, after=after))
    overrides = ["model=function", f"model.path={model}", "dataset.n=40", "budget.evaluations=500"]
    code, out, err = identify(*overrides, "optimizer=random", "optimizer.batch=1")
    (line,) = out.splitlines() if when == "run" else err.splitlines()
    assert code == (2 if when == "import" and "Exit" in deed else 3)
    assert deed.split()[1].partition("(")[0] in line
    assert "model.py:" in line
    assert "Traceback" not in err


def test_constraints_and_quantities_are_stored_and_reported(
    identify: Command, own: Path, tmp_path: Path
) -> None:
    """a is 2 and b 1.5, so the order holds and the results are those without it."""
    chosen = ["--config-dir", str(own), "experiment=mine", f"root={tmp_path / 'runs'}"]
    code, plain, err = identify(*chosen)
    assert code == 0, err
    added = ["problem.constraints='b < a'", '+space.K={unit: V/s, tied: "a * b"}']
    code, out, err = identify(*chosen, *added)
    assert code == 0, err

    def rows(text: str) -> list[list[str]]:
        return [
            line.split()[:3] for line in text.splitlines() if line.split()[:1] in (["a"], ["b"])
        ]

    assert rows(out) == rows(plain)
    assert len(rows(out)) == 2
    assert "K = a * b" in out
    assert identify(*chosen, *added)[1].count("done before") == 1
    runs = list((tmp_path / "runs" / "decay-my" / "miho_gn").iterdir())
    assert len(runs) == 2
    for run in runs:
        problem = rebuild(read_run(run), trusted=True)
        assert problem.space.names in (("a", "b"), ("a", "b_share"))


def test_a_folder_of_further_options(identify: Command, own: Path, tmp_path: Path) -> None:
    chosen = ["--config-dir", str(own), "experiment=mine", "optimizer=least_squares"]
    code, out, err = identify(*chosen)
    assert code == 0, err
    assert "decay-my" in out
    code, out, err = identify(*chosen, "-m", "seed=0,1")
    assert code == 0, err
    assert out.splitlines()[-1] == "2 runs: 1 ran, 1 done before"
    ((_, _, _, _, folder, *_),) = sweep_commands(tmp_path / "runs")
    assert Path(folder.removeprefix("--config-dir=")).resolve() == own
    # What the hint says can be typed, and reports on the runs of a model that is code in a file.
    (hint,) = (line for line in out.splitlines() if line.startswith("how far to trust"))
    words = shlex.split(hint.partition(": ")[2])
    assert words == ["python", "-m", "experiments.report", str(tmp_path / "runs"), "--trust"]
    assert f"--trust allows it to run {own / 'decay.py'}" in hint
    assert "Mine." in identify("--config-dir", str(own), "experiment", "--help")[1]
    path = f"dataset.path={own / 'my.csv'}"  # with a blank
    listed = identify(*chosen[:3], path, "-m", "sweep.dry_run=true")[1]
    assert shlex.split(listed.splitlines()[0])[:4] == ["to", "do:", "experiment=mine", path]


def test_an_interrupt_during_the_imports_has_no_traceback() -> None:
    ended = subprocess.run(
        [sys.executable, "-c", "import experiments; raise KeyboardInterrupt"],
        capture_output=True, text=True,
    )  # fmt: skip
    assert ended.returncode == -signal.SIGINT
    assert ended.stderr == "interrupted by SIGINT\n"


@pytest.mark.slow
def test_a_trajectory_as_the_manual_shows_it(
    identify: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """x'' = (force - 8 x - 0.9 x') / 2 by SciPy, for a right-hand side and a YAML of the page."""
    page = (Path(__file__).parent.parent / "docs" / "trajectories.md").read_text(encoding="utf-8")
    (settings,) = (
        s for s in re.findall(r"```yaml\n(.*?)```", page, re.DOTALL) if "rhs: swing" in s
    )
    (function,) = re.findall(r"(def swing.*?)\n\n\n", page, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "options" / "experiment").mkdir(parents=True)
    (tmp_path / "options" / "experiment" / "swing.yaml").write_text(settings)
    (tmp_path / "swing.py").write_text(function)
    t = np.linspace(0, 10, 201)
    system = ([[0, 1], [-4, -0.45]], [[0], [0.5]], [[1, 0]], [[0]])
    _, x, _ = lsim(system, np.sin(t), t, [0.0, 0.4])
    rows = zip(t, np.sin(t), x + 0.001 * np.cos(40 * t), strict=True)
    lines = [",".join(map(repr, map(float, row))) for row in rows]
    (tmp_path / "swing.csv").write_text("\n".join(["t,force,x", *lines]) + "\n")
    code, out, err = identify("--config-dir", "options", "experiment=swing", "root=runs")
    assert code == 0, err
    values = {name: float(value) for name, value in re.findall(r"^ +(k|c|v_0) +(\S+)", out, re.M)}
    assert values == pytest.approx({"k": 8.0, "c": 0.9, "v_0": 0.4}, rel=0.01)


def test_a_space_on_the_command_line_replaces_the_chosen_one(identify: Command, own: Path) -> None:
    space = "space={a: {unit: V, low: 1, high: 3}, b: {unit: 1/s, low: 1, high: 2}}"
    for chosen in (
        ["--config-dir", str(own), "experiment=mine"],
        ["model=function", f"model.path={own / 'decay.py'}", "dataset=csv",
         f"dataset.path='{own / 'my.csv'}'", "dataset.columns=[t,y]", "dataset.units=[s,V]",
         "dataset.output=y"],
    ):  # fmt: skip
        code, out, _ = identify(*chosen, space, "--cfg", "job", "--package", "space")
        assert code == 0
        assert {line for line in out.splitlines() if line.startswith("  low")} == {"  low: 1.0"}
        assert identify(*chosen, space, "optimizer=least_squares")[0] == 0


@pytest.mark.parametrize("sweep", [[], ["-m"]])
def test_a_received_experiment_names_no_other_code(
    identify: Command, own: Path, tmp_path: Path, sweep: list[str]
) -> None:
    text = "# @package _global_\nmodel: {_target_: os.system}\n"
    (own / "experiment/mine.yaml").write_text(text)
    code, out, err = identify("--config-dir", str(own), "experiment=mine", *sweep)
    assert (code, out) == (2, "")
    assert err.startswith("error: model._target_: 'os.system'")
    assert err.count("\n") == 1
    assert load_runs(tmp_path / "runs").runs.empty


def test_help_is_short_and_of_each_command(identify: Command, compare: Command) -> None:
    texts = [run("--help")[1] for run in (identify, compare)]
    assert texts[0] != texts[1]
    names = "identify", "compare"
    for text, name, own_setting in zip(texts, names, ("seed", "repetitions"), strict=True):
        assert f"python -m experiments.{name}" in text
        assert len(text.splitlines()) < 40
        assert max(map(len, text.splitlines())) <= 100
        assert own_setting in text
    code, out, _ = identify("dataset=csv", "--help")
    assert code == 0
    assert out.strip() == (ROOT / "conf" / "dataset" / "csv.yaml").read_text().strip()
    code, out, _ = identify("loss", "--help")
    assert [line.split()[0] for line in out.splitlines()[1:]] == ["cauchy", "huber", "square"]
    options = [line.split()[0] for line in identify("optimizer", "--help")[1].splitlines()[1:]]
    assert {"miho", "r500/miho"} < set(options)


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        ("optimizer=pso_c", ["pso_constriction"]),
        ("optim", ["optimizer="]),
        ("-m optimizer=miho,pso_c", ["miho,pso_constriction"]),
        ("seed=0 loss=", ["cauchy", "huber", "square"]),
        ("optimizer=r500/mi", ["r500/miho", "r500/miho_reference"]),
        ("--config-dir @ optimizer=fire", ["firefly"]),
        ("optimizer=fire", []),
        ("-cd=@ optim", ["optimizer="]),
    ],
)
def test_completion(identify: Command, tmp_path: Path, typed: str, completed: list[str]) -> None:
    (tmp_path / "optimizer").mkdir()
    (tmp_path / "optimizer" / "firefly.yaml").touch()
    typed = typed.replace("@", str(tmp_path))
    script = identify("--shell-completion")[1]
    line = f"python -m experiments.identify {typed}"
    program = (
        f"COMP_LINE='{line}' COMP_POINT={len(line)}; _miho; printf '%s\n' \"${{COMPREPLY[@]}}\""
    )
    bash = subprocess.run(
        ["bash", "-c", f"{script}\n{program}"], capture_output=True, text=True, check=True
    )
    assert bash.stdout.split() == completed


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("problem=tire_lf", "error: problem: cannot be chosen here"),
        ("seed=3", "error: seed: cannot be chosen here; set comparison.repetitions"),
        ("sweep.workers=0", "error: sweep.workers: is 0"),
        ("comparison.repetitions=0", "error: comparison.repetitions: is 0"),
        ("comparison.processes=2", "error: comparison.processes: is now sweep.workers"),
        ("comparison.problems=[]", "error: experiment: compares nothing; choose one that sweeps"),
        ("experiment=compare comparison.problems=[tire_lf]", "error: comparison.problems: is for"),
        ("experiment=compare comparison.repetitions=2", "error: comparison.repetitions: is for an"),
        ("-m", "error: comparison.problems: is for an arena, and this is a sweep; start an arena "),
        ("-m hydra/launcher=basic", "error: hydra/launcher: makes no comparison; leave it out, or"),
        ("experiment=torque_gap problem=torque_05", "error: problem=torque_05: is about dataset=t"),
    ],
)
def test_what_a_comparison_cannot_combine_is_refused(
    compare: Command, override: str, message: str
) -> None:
    words = override.split()
    arena = [] if words[0].startswith("experiment=") else ["experiment=arena_small"]
    code, out, err = compare(*arena, *words)
    assert code == 2
    assert out == ""
    assert err.splitlines()[-1].startswith(message)


def test_a_missing_download_is_one_line(
    identify: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "miho.vehicle.data.seong.sample_file.__defaults__", ("http://127.0.0.1:9/x", tmp_path)
    )
    monkeypatch.delenv("MIHO_DATA_DIR", raising=False)
    code, _, err = identify("dataset=seong_sample_a")
    assert code == 2
    assert err.splitlines()[-1].startswith("error: http://127.0.0.1:9/x: cannot be downloaded")


def test_a_full_disk_is_exit_4(identify: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", "somewhere")

    monkeypatch.setattr("os.fsync", full)
    code, _, err = identify(*QUICK)
    assert code == 4
    last = err.splitlines()[-1]
    assert last.startswith("error: /")
    assert last.endswith("/config.json: No space left on device")
    assert "Error executing job" not in err


@pytest.mark.slow
def test_compare_writes_figure_tables_and_provenance(compare: Command, tmp_path: Path) -> None:
    small = ["experiment=compare", "seed=0,1", "budget.seconds=0.05", "dataset.n=100"]
    code, out, _ = compare(*small)
    assert code == 0
    assert "[18/18]" in out
    assert "18 runs: 18 ran" in out
    written = {path.name for path in (tmp_path / "runs" / "figures").iterdir()}
    assert {"fig6.png", "fig6.pdf", "claims.md", "claims.csv", "results.md"} <= written
    provenance = json.loads((tmp_path / "runs" / "figures" / "provenance.json").read_text())
    assert provenance["seeds"] == "0 to 1"
    assert "experiments.compare" in provenance["command"]
    code, out, _ = compare(*small)
    assert "18 runs: 18 done before" in out
    order = [line.split()[2] for line in out.splitlines() if line.startswith("[")]
    assert order[:9] == order[9:], "methods are interleaved inside a repetition"


@pytest.mark.slow
def test_a_run_that_is_killed_leaves_the_others_and_the_comparison_undrawn(
    compare: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The model kills its process at its 200th call, which only small batches come to."""
    model = tmp_path / "fatal.py"
    model.write_text(MODEL.format(how="kill"), encoding="utf-8")
    small = ["seed=0", "budget.evaluations=2000", "budget.seconds=null", "dataset.n=40"]
    overrides = ["optimizer=pso_100,nelder_mead", "model=function", f"model.path={model}"]
    code, out, err = compare(*small, *overrides)
    assert code == 3
    assert "nelder_mead seed 0: lost: killed by SIGKILL" in out
    last = err.splitlines()[-1]
    assert last.startswith("runs missing: 1")
    assert last.endswith(f"python -m experiments.figures fig6 root={tmp_path / 'runs'}")
    assert load_runs(tmp_path / "runs").runs["optimizer"].tolist() == ["pso_100"]
    assert not (tmp_path / "runs" / "figures").exists()


@pytest.mark.slow
def test_a_dry_run_of_an_arena_lists_its_runs(compare: Command) -> None:
    problems = "comparison.problems=[tire_lf,torque_15]"
    code, out, _ = compare("experiment=arena_small", problems, "sweep.dry_run=true")
    assert code == 0
    assert "to do: problem=tire_lf optimizer=miho seed=0" in out
    assert out.splitlines()[-1] == "78 runs: 78 to do"
    methods = "comparison.methods={miho: {R: 30}, random: {}, pso_100: {particles: 5}}"
    added = "+comparison.methods.least_squares={}"
    code, out, _ = compare("experiment=arena_small", problems, methods, added, "sweep.dry_run=true")
    assert (code, out.splitlines()[-1]) == (0, "24 runs: 24 to do")


@pytest.mark.slow
def test_a_method_that_raises_leaves_the_others_and_the_comparison_undrawn(
    compare: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("nevergrad")
    methods = ["optimizer=random,mine/ngopt", f"--config-dir={tmp_path / 'own'}"]
    (tmp_path / "own" / "optimizer" / "mine").mkdir(parents=True)
    (tmp_path / "own" / "optimizer" / "mine" / "ngopt.yaml").write_text(
        "# @package optimizer\ndefaults: [/optimizer/ngopt@_here_, _self_]\nplan: null\n"
    )
    small = ["seed=0", "budget.seconds=0.2", "budget.evaluations=null"]
    code, out, err = compare(*methods, *small, "dataset=tire_lf", "dataset.n=40")
    assert code == 3
    assert "ngopt seed 0: failed: ValueError: plan is None" in out
    assert "run again" in err.splitlines()[-1]
    assert load_runs(tmp_path / "runs").runs["optimizer"].tolist() == ["random"]
    assert not (tmp_path / "runs" / "figures").exists()


@pytest.mark.slow
def test_fig4_of_four_identified_tires(
    identify: Command,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    root = str(tmp_path / "runs")
    arguments = ["figures", "fig4", "--root", root, "--optimizer", "least_squares"]
    monkeypatch.setattr(sys, "argv", arguments)
    assert identify("optimizer=least_squares", "dataset=tire_lf", "dataset.n=200")[0] == 0
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(SystemExit) as end:
        figures.main()
    assert end.value.code == 2
    assert "no run of least_squares on tire_rf; run python -m" in capsys.readouterr().err
    identify("-m", "dataset=tire_rf,tire_lr,tire_rr", *QUICK)
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(SystemExit) as end:
        figures.main()
    assert end.value.code == 0
    folder = tmp_path / "runs" / "figures"
    assert (folder / "fig4.pdf").stat().st_size > 10_000
    assert "front axle, learned from property data" in capsys.readouterr().out
    axle = json.loads((folder / "fig4.json").read_text())["front_axle"]
    assert sum(axle["sampled_at"]) == pytest.approx(6510.0, rel=0.02)
    sampled, loaded, turning = (model["error"] for model in axle["models"].values())
    assert turning < loaded < 0.2 * sampled


@pytest.mark.slow
def test_fig5_of_three_identified_torque_curves(
    identify: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    methods = ("dataset=torque_05,torque_15,torque_20", "optimizer=least_squares")
    assert identify("-m", *methods)[0] == 0
    folder = tmp_path / "runs" / "figures"
    arguments = ["figures", "fig5", "--root", str(tmp_path / "runs")]
    monkeypatch.setattr(sys, "argv", [*arguments, "--optimizer", "least_squares"])
    with pytest.raises(SystemExit) as end:
        figures.main()
    assert end.value.code == 0
    assert (folder / "fig5.pdf").stat().st_size > 10_000
    about = json.loads((folder / "fig5.json").read_text())
    assert [run["problem"] for run in about["runs"]] == [
        "torquecubic-torque_05", "torquecubic-torque_15", "torquecubic-torque_20"
    ]  # fmt: skip
    assert about["command"].startswith("python -m experiments.figures fig5")


@pytest.mark.slow
@pytest.mark.parametrize("sweep", [[], ["-m", "seed=0,1"]])
def test_ctrl_c_keeps_the_curve_and_the_next_call_runs_again(
    tmp_path: Path, sweep: list[str]
) -> None:
    for patience in (1.0, 5.0, 25.0, 50.0):  # [s] a busy machine may still be compiling the loss
        root = tmp_path / str(patience)
        arguments = [sys.executable, "-m", "experiments.identify", *sweep, "optimizer=random"]
        arguments += [f"root={root}", "budget.evaluations=null", "budget.seconds=60"]
        process = subprocess.Popen(
            arguments, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        deadline = time.monotonic() + 300
        while not list(root.rglob("lock")) and time.monotonic() < deadline:
            time.sleep(0.05)
        time.sleep(patience)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=100)
        assert process.returncode == 130, err
        assert "Traceback" not in err
        assert load_runs(root).runs.empty
        curves = [json.loads(path.read_text())["curve"] for path in root.rglob("partial.json")]
        if any(curve and curve["loss"] for curve in curves):
            break
    (curve,) = curves
    assert "interrupted" in out
    assert not sweep or out.splitlines()[-1] == "2 runs: 1 interrupted, 1 to do"
    assert curve["loss"]


@pytest.mark.slow
def test_sigterm_stops_what_the_shell_made_deaf_to_ctrl_c() -> None:
    """As `command &` in a script is: the shell ignores SIGINT for it."""
    program = (
        "import signal, time; from experiments.app.console import run_and_exit;"
        "signal.signal(signal.SIGINT, signal.SIG_IGN);"
        "run_and_exit(lambda: (print('ready', flush=True), time.sleep(60)))"
    )
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=20) == 128 + signal.SIGTERM


@pytest.mark.slow
def test_help_names_the_groups() -> None:
    process = subprocess.run(
        [sys.executable, "-m", "experiments.identify", "--help"],
        cwd=ROOT,
        env=dict(os.environ),
        capture_output=True,
        text=True,
        check=True,
    )
    for group in ("dataset (", "optimizer (", "space ("):
        assert group in process.stdout
