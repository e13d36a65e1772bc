"""Scores of sessions, each stored with the identity of its session, and found again by it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from baselines.online import Stream
from experiments.app.origin import packages_of, tracking_code
from miho.online import OnlineMethod
from miho.study import Identity, environment_stamp, write_text
from miho.study.files import DamagedRun, read_signed, signed
from miho.study.identity import sha256
from miho.study.manifest import ResumeRefused

SCORE = "score.json"
ORIGIN = ("problem", "optimizer", "seed", "id", "code", "data", "packages", "config")
"""Parts of the identity that are stored with a score."""
SHARED = ("problem", "code", "packages")
"""Parts of the identity that all scores of a comparison share."""


def identity_of(
    tracker: str, seed: int, method: OnlineMethod, stream: Stream, config: Mapping[str, Any]
) -> Identity:
    """Return the identity of a session: its request, its code, its stream and the packages."""
    columns = {**stream.columns, **{f"true {name}": stream.truth[name] for name in stream.truth}}
    data = b"".join(f"\0{n}\0".encode() + columns[n].tobytes() for n in sorted(columns))
    return Identity(
        f"{config['stream']['_target_'].rpartition('.')[2]}_{stream.kind}", tracker, seed, config,
        tracking_code(), sha256(data), packages_of(method),
    )  # fmt: skip


def is_stored(root: Path, identity: Identity, *, fresh: bool) -> bool:
    """Whether the folder of a session has its score, undamaged.

    Raises ResumeRefused if it has the score of another identity, unless `fresh`.
    """
    try:
        stored = read_signed(str(root / SCORE))
    except (OSError, DamagedRun):
        return False
    if stored.get("id") == identity.id:
        return True
    if fresh:
        return False
    raise ResumeRefused(
        f"{root}: has a score with other code, data, settings or packages; replace it with "
        "fresh=true, or choose another root"
    )


def store(root: Path, identity: Identity, found: Mapping[str, Any]) -> None:
    """Write a score with the identity and the machine of its session."""
    origin = {name: getattr(identity, name) for name in ORIGIN}
    write_text(
        root / SCORE, signed({**origin, "score": dict(found), "environment": environment_stamp()})
    )


def comparable(root: Path, like: Identity) -> tuple[list[dict[str, Any]], int]:
    """Return the scores below a folder of the same stream and code, and the number of others."""
    stored, others = [], 0
    for path in sorted(root.glob(f"*/{SCORE}")):
        try:
            score = read_signed(str(path))
        except DamagedRun:
            score = {}
        same = all(score.get(name) == getattr(like, name) for name in SHARED)
        settings = [dict(each or {}) for each in (score.get("config"), like.config)]
        if same and all(settings[0].get(key) == settings[1][key] for key in ("stream", "online")):
            stored.append(score)
        else:
            others += 1
    return stored, others
