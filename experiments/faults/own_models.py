"""R23: models of the user's that hang, raise what nobody expects, or start processes."""

from __future__ import annotations

from pathlib import Path

from experiments.faults.called import Call, begun, prepare
from experiments.faults.row import Row

MARK = "98765.4"
"""So long do the processes sleep that the models start: nobody else's do."""
DEEDS = {
    "hangs": "time.sleep(1000)",
    "base": "raise Odd('no')",
    "interrupts": "raise KeyboardInterrupt",
    "unfolds": "place = tempfile.mkdtemp(); os.chdir(place); os.rmdir(place); raise Odd('gone')",
    "forks": f"[subprocess.Popen(['sleep', '{MARK}'], start_new_session=s) for s in (True, False)]",
}
ENDS = ("hangs", "base", "interrupts", "unfolds")
"""Those that cannot have a result."""
MODEL = '''"""A line that does something at its import or at its first call."""
import os, subprocess, tempfile, time
class Odd(BaseException):
    pass
with open({log!r}, "a") as file:
    file.write(str(os.getpid()) + "\\n")
{early}
def line(alpha: "rad", *, B: "1/rad", C: "-", D: "N", Sx: "rad", Sy: "N") -> "N":
    {late}
    return Sy - B * D * (alpha - Sx)
'''


def own_models(folder: Path) -> Row:
    """Each deed at import and at the first call, in one sweep with a time limit, and a good one."""
    prepare()
    log, paths = folder / "log", []
    for name, deed in {**DEEDS, "good": "pass"}.items():
        for when in ("import", "call"):
            path = folder / f"{name}_{when}.py"
            early, late = (deed, "pass") if when == "import" else ("pass", deed)
            path.write_text(MODEL.format(log=str(log), early=early, late=late), encoding="utf-8")
            paths.append(str(path))
    sweep = begun(Call([
        "-m", "model=function", f"model.path={','.join(paths)}", "dataset.n=40", "optimizer=random",
        "budget.evaluations=50", f"root={folder / 'runs'}", "sweep.time_limit=3",
    ]))  # fmt: skip
    parent, ended = str(sweep.pid), sweep.end()
    lost = [line for line in ended.out.splitlines() if line.startswith("lost:")]
    named = sum(any(f"{name}_{when}.py" in line for line in lost)
                for name in ENDS for when in ("import", "call"))  # fmt: skip
    done = len(list((folder / "runs").glob("*/*/*/result.json")))
    left = len(_sleeping())
    here = parent in log.read_text(encoding="utf-8").split()
    wanted, good = 2 * len(ENDS), len(paths) - 2 * len(ENDS)
    return Row(
        "R23",
        "models that hang, raise a BaseException or KeyboardInterrupt, remove their folder or "
        "start processes, at import and at the first call",
        "each lost alone with one line, exit 3; nothing of it in the parent; no process left",
        f"{named} of {wanted} lost with a line, {done} of {good} others done, exit {ended.code}; "
        f"in the parent: {'yes' if here else 'nothing'}; {left} processes left",
        (named, len(lost), done, ended.code, left, here) == (wanted, wanted, good, 3, 0, False),
    )


def _sleeping() -> list[int]:
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if MARK.encode() in path.read_bytes().split(b"\0"):
                found.append(int(path.parent.name))
        except OSError:
            continue
    return found
