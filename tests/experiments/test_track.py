"""A stream of rows to a stream of states."""

from __future__ import annotations

import io
import json
import math
import os
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import miho
from baselines.online import tire
from experiments.app.build import ConfigError
from experiments.app.compose import composed
from experiments.online.comparison import score, write_session
from experiments.online.session import Session, repair, replay
from experiments.online.sources import Lines, Replay, Socket, Source, parsed
from experiments.online.task import Task, begun, task_of
from miho.models import FunctionModel
from miho.online import Tracker
from miho.vehicle.data.synthetic_drive import DRIVE_TRUTH

N = 60


def line_problem() -> miho.CurveFit:
    """y = a x, with a small error."""
    x = np.linspace(1, 2, 30)
    data = miho.Dataset("line", {"x": x, "y": 2 * x}, {"x": "", "y": ""}, "y")
    return miho.CurveFit(
        FunctionModel(slope), data, miho.Space((miho.Parameter("a", "", 0, 5),)), sigma=0.05
    )


def slope(x, *, a):  # type: ignore[no-untyped-def]
    """A line through the origin."""
    return a * x


def rows(count: int = N) -> list[dict[str, float]]:
    """Rows of y = 2 x, and of y = 1.2 x from the middle."""
    rng = np.random.default_rng(0)
    x = rng.uniform(1, 2, count)
    y = np.where(np.arange(count) < count / 2, 2.0, 1.2) * x + 0.05 * rng.standard_normal(count)
    return [{"time": 0.02 * k, "x": x[k], "y": y[k]} for k in range(count)]


def tracker() -> Tracker:
    """A tracker of a."""
    return miho.Tracker(line_problem(), prior={"a": (2.0, 0.05)})


class Answered(Lines):
    """Lines whose answers are kept."""

    def __init__(self, text: str) -> None:
        super().__init__(io.StringIO(text))
        self.answers: list[dict[str, object]] = []

    def answer(self, text: str) -> None:
        """Keep the answer."""
        self.answers.append(json.loads(text))


def test_each_line_has_one_answer_and_a_bad_line_says_why(tmp_path: Path) -> None:
    """The states go on after a bad line, and the alarm is in words."""
    lines = [json.dumps(row) for row in rows()]
    lines[3:3] = ["nonsense", '{"x": "one"}', "[1]"]
    source = Answered("\n".join(lines) + "\n")
    Session(tracker(), ("x", "y"), tmp_path, {"a": "the slope"}).run(source)
    assert len(source.answers) == N + 3
    assert [list(answer) for answer in source.answers[3:6]] == [["error"]] * 3
    assert "expected a number or null" in str(source.answers[4]["error"])
    said = [answer["alarm"] for answer in source.answers if answer.get("alarm")]
    assert len(said) == 1
    assert str(said[0]).startswith("the slope fell by")
    assert math.isclose(source.answers[-1]["values"]["a"], 1.2, rel_tol=0.05)  # type: ignore[index]


def test_a_session_can_be_resumed_to_the_last_bit(tmp_path: Path) -> None:
    """Half of the rows, files, the other half: the same states as in one session."""
    whole, half = tracker(), tracker()
    for row in rows():
        whole.update(row)
    session = Session(half, ("x", "y"), tmp_path, quiet=True)
    session.run(Answered("\n".join(json.dumps(row) for row in rows()[: N // 2])))
    paths = write_session(tmp_path, half, session.alarms, [], "a line", {"a": "N"})
    assert {path.name for path in paths} >= {"states.csv", "report.html", "parameters.json"}
    again = tracker()
    replay(again, tmp_path / "rows.jsonl")
    Session(again, ("x", "y"), tmp_path, quiet=True).run(
        Answered("\n".join(json.dumps(row) for row in rows()[N // 2 :]))
    )
    assert isinstance(again, Tracker)
    assert again.state.theta.tolist() == whole.state.theta.tolist()
    assert len((tmp_path / "states.csv").read_text().splitlines()) == N + 1


def test_a_line_that_is_cut_off_is_removed_and_damage_has_a_number(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Only a last line without an end is of a session that was killed."""
    file = tmp_path / "rows.jsonl"
    lines = [json.dumps(row) + "\n" for row in rows(4)]
    file.write_text("".join(lines)[:-9])
    repair(file)
    assert "the last line is cut off and was removed" in capsys.readouterr().err
    assert file.read_text() == "".join(lines[:3])
    repair(file)
    assert not capsys.readouterr().err
    running = tracker()
    replay(running, file)
    assert running.state.rows == 3
    file.write_bytes(lines[0].encode() + b"\xff\0\n" + lines[2].encode())
    with pytest.raises(ValueError, match=r"rows.jsonl, line 2: Expecting value"):
        replay(tracker(), file)


def test_the_delay_of_a_score_is_relative_to_the_new_value(tmp_path: Path) -> None:
    """D falls by 35 % in 0.2 s and is within 10 % of its new value after 0.163 s, at a row 0.18."""
    stream = tire("jump", 1, 40.0)
    truth = stream.truth["D"]
    columns = {"time": stream.clock, "D": truth, "D_low": truth, "D_high": truth}
    pd.DataFrame(columns).to_csv(tmp_path / "states.csv", index=False)
    scored = score(tmp_path, "perfect", 1, stream, [])
    assert scored["within_10"] == pytest.approx(0.18, abs=1e-9)
    assert (scored["error"], scored["coverage"], scored["alarm"]) == (0.0, 1.0, None)


def test_an_interrupt_keeps_the_states_so_far(tmp_path: Path) -> None:
    """The file has every state before Ctrl-C."""

    class Interrupted(Source):
        def rows(self) -> Iterator[dict[str, float]]:
            yield from rows(10)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Session(tracker(), ("x", "y"), tmp_path, quiet=True).run(Interrupted())
    assert len((tmp_path / "states.csv").read_text().splitlines()) == 11


def test_a_line_of_any_size_is_a_row_or_an_error() -> None:
    """An integer that is no double is infinite; brackets may be nested without end."""
    row = parsed('{"x": 1' + 5000 * "0" + ', "y": 2}', ("x", "y"))
    assert row == {"x": math.inf, "y": 2.0}
    with pytest.raises(ValueError, match=r"the line is '\[\[.*; expected JSON \(maximum recursion"):
        parsed(100_000 * "[", ("x", "y"))


def test_bytes_that_are_no_text_are_a_bad_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stdin is read as UTF-8 in every locale."""
    stdin = io.TextIOWrapper(io.BytesIO(b"\xff\n{}\n"), encoding="ascii")
    monkeypatch.setattr("sys.stdin", stdin)
    assert list(Lines().rows()) == ["\ufffd\n", "{}\n"]


def test_a_missing_column_is_unknown() -> None:
    """Null and a missing column are NaN, and further columns are kept."""
    row = parsed('{"x": 1, "y": null, "time": 2}', ("x", "y", "z"))
    assert row["x"] == 1.0
    assert row["time"] == 2.0
    assert math.isnan(row["y"])
    assert math.isnan(row["z"])


def test_a_dataset_without_times_is_replayed_by_its_period() -> None:
    """The time rises by the period."""
    data = miho.Dataset("d", {"x": np.ones(3), "y": np.ones(3)}, {"x": "", "y": ""}, "y")
    rows = Replay(data.columns, 0.1).rows()
    assert [row["time"] for row in rows] == pytest.approx([0.0, 0.1, 0.2])


def test_a_replay_without_times_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    task_of(composed(["dataset=front_axle", "stream=replay", "online.learn=20"]))
    assert "has no column 'time': its rows are replayed as 0.02 s apart" in capsys.readouterr().err


def test_a_source_refuses_a_wrong_rate_and_port() -> None:
    """Before a row is read."""
    data = miho.Dataset("d", {"x": np.ones(3), "y": np.ones(3)}, {"x": "", "y": ""}, "y")
    with pytest.raises(ValueError, match=r"stream.rate is 0; expected a positive number"):
        Replay(data.columns, 0.1, rate=0)
    with pytest.raises(ValueError, match=r"stream.port is 99999; expected a whole number"):
        Socket(port=99_999)


def test_a_client_of_the_socket_gets_a_state_for_each_row(tmp_path: Path) -> None:
    """On the loopback, by a client of the standard library."""
    source = Socket(port=0)
    session = Session(tracker(), ("x", "y"), tmp_path)
    server = threading.Thread(target=session.run, args=(source,), daemon=True)
    server.start()
    with (
        socket.create_connection(("127.0.0.1", source.port), timeout=20) as connection,
        connection.makefile("rw", encoding="utf-8") as client,
    ):
        for k, row in enumerate(rows(5)):
            client.write(json.dumps(row) + "\n")
            client.flush()
            assert json.loads(client.readline())["row"] == k + 1
        client.write("".join(json.dumps(row) + "\n" for row in rows(100)))
        client.flush()
        assert [json.loads(client.readline())["row"] for _ in range(100)] == [*range(6, 106)]
    source.server.shutdown(socket.SHUT_RDWR)
    source.server.close()
    server.join(timeout=20)


def test_a_client_that_goes_in_the_middle_of_a_line_does_not_end_the_session(
    tmp_path: Path,
) -> None:
    """The connection is reset with states unread; the next client gets its states."""
    source = Socket(port=0)
    session = Session(tracker(), ("x", "y"), tmp_path)
    server = threading.Thread(target=session.run, args=(source,), daemon=True)
    server.start()
    for text in (b'{"x": 1, "y": 2}\n' * 100 + b'{"x": 1, "y"', b"\xff\n"):
        with socket.create_connection(("127.0.0.1", source.port), timeout=20) as connection:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            connection.sendall(text)
            connection.recv(1)
    with (
        socket.create_connection(("127.0.0.1", source.port), timeout=20) as connection,
        connection.makefile("rw", encoding="utf-8") as client,
    ):
        client.write('{"x": 1, "y": 2}\n')
        client.flush()
        assert json.loads(client.readline())["values"]["a"] == pytest.approx(2, abs=0.1)
    source.server.shutdown(socket.SHUT_RDWR)
    source.server.close()
    server.join(timeout=20)
    assert not server.is_alive()


DRIVE = ["dataset=lively_drive", "dataset.duration=4.0", "online.changes={D_f: 0.35, D_r: 0.35}"]


@pytest.fixture(scope="module")
def drive() -> Task:
    """A drive with three outputs, the first 2 s of which are the offline data."""
    return task_of(composed([*DRIVE, "stream=replay", "online.learn=2.0"]))


@pytest.mark.parametrize("tracker", ["miho", "ekf"])
def test_the_log_of_a_differential_equation_is_replayed(
    drive: Task, tracker: str, tmp_path: Path
) -> None:
    """Each time is a row with all outputs; the first one begins the motion."""
    cfg = composed([*DRIVE, f"tracker={tracker}"])
    session = Session(begun(cfg, tmp_path, drive), drive.columns, tmp_path, quiet=True)
    session.run(drive.source)
    assert drive.columns == ("vx", "vy", "yaw_rate", "ax", "steering")
    assert session.bad == 0
    assert session.last is not None
    assert session.last.rows == 99
    assert session.last.time == pytest.approx(3.98)
    for name in ("D_f", "D_r"):
        assert session.last.values[name] == pytest.approx(DRIVE_TRUTH[name], rel=0.1)
    assert len((tmp_path / "states.csv").read_text().splitlines()) == 101
    paths = write_session(tmp_path, session.running, [], [], "a drive", drive.units)
    assert tmp_path / "report.html" in paths


def test_lines_of_a_differential_equation_are_answered_one_by_one(
    drive: Task, tmp_path: Path
) -> None:
    """A row is known by the name of the model's time or by "time"; a null is no step."""
    assert isinstance(drive.source, Replay)
    rows: list[dict[str, float | None]] = [{**row} for row in islice(drive.source.rows(), 10)]
    rows[1]["t"] = rows[1].pop("time")
    rows[6]["vx"] = None
    del rows[8]["time"]
    source = Answered("\n".join(map(json.dumps, rows)) + "\n")
    running = begun(composed(DRIVE), tmp_path, drive)
    Session(running, drive.columns, tmp_path).run(source)
    assert [answer.get("row") for answer in source.answers] == [0, 1, 2, 3, 4, 5, 6, 7, None, 8]
    assert source.answers[0]["time"] is None
    assert "no column 't'" in str(source.answers[8]["error"])


def test_the_task_of_an_unmeasured_state_is_refused() -> None:
    """Before the search of the offline data."""
    with pytest.raises(ConfigError, match=r"the state 'vy' of .* is not measured; expected all"):
        task_of(composed(["dataset=steering_test", "stream=replay"]))


CLIENT = r"""
coproc T { exec "$@"; }
for k in 1 2 3; do
  echo "{\"alpha\": -0.0$k, \"Fy\": 1000}" >&${T[1]}
  IFS= read -r state <&${T[0]} && echo "$state"
done
"""


@pytest.mark.slow
def test_a_shell_script_gets_a_state_for_each_row(tmp_path: Path) -> None:
    """The script sends the next row only after the state of the last one."""
    command = [sys.executable, "-m", "experiments.track", "dataset=front_axle", f"root={tmp_path}"]
    done = subprocess.run(
        ["bash", "-c", CLIENT, "client", *command],
        capture_output=True, text=True, timeout=120, env=os.environ, check=True,
    )  # fmt: skip
    states = [json.loads(line) for line in done.stdout.splitlines()]
    assert [state["row"] for state in states] == [1, 2, 3]
    assert all(state["seconds"] > 0 for state in states)
