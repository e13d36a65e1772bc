"""A session with its files, and for a stream with known truth its stored score."""

import sys
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from baselines.online import Stream
from experiments.online.session import LiveView, Session, in_words
from experiments.online.stored import identity_of, is_stored, store
from experiments.online.task import Task, begun, method_of, request_of
from miho.online import Running


def follow_to_score(cfg: DictConfig, root: Path, task: Task, stream: Stream) -> None:
    """Take all rows, then store the score; a sweep does so once, with calibrated alarms."""
    from experiments.online.comparison import compare, score, watched  # slow: it draws

    several = HydraConfig.get().mode is RunMode.MULTIRUN
    name = HydraConfig.get().runtime.choices["tracker"]
    method, request = method_of(cfg), request_of(cfg)
    identity = identity_of(name, cfg.seed, method, stream, request)
    if several and is_stored(root, identity, fresh=cfg.fresh):
        print(f"{name}, seed {cfg.seed}: done before")
    else:
        running = begun(cfg, root, task)
        if several:
            running = watched(running, name, method, request["stream"]["_target_"])
        session = follow(cfg, root, task, running)
        store(root, identity, score(root, name, cfg.seed, stream, session.alarms))
    if several:
        compare(Path(cfg.root), identity)


def follow(cfg: DictConfig, root: Path, task: Task, running: Running) -> Session:
    """Take all rows of the source; write the results, also after an interrupt."""
    name = HydraConfig.get().runtime.choices["tracker"]
    several = HydraConfig.get().mode is RunMode.MULTIRUN
    quiet = several or (cfg.online.live and sys.stdout.isatty())
    view = LiveView(sys.stdout) if quiet and not several else None
    words = {str(key): str(value) for key, value in cfg.online.names.items()}
    session = Session(running, task.columns, root, words, view, quiet)
    try:
        session.run(task.source)
    finally:
        from experiments.online.comparison import write_session  # slow: it draws

        sentences = [in_words(alarm, words) for alarm in session.alarms]
        if session.last is not None:
            if view is not None:
                view.show(session.last, sentences, last=True)
            title = f"Parameters tracked by {name}"
            paths = write_session(root, running, session.alarms, sentences, title, task.units)
            out = sys.stdout if quiet else sys.stderr
            for text in sentences:
                print(f"{name}, seed {cfg.seed}: {text}" if several else text, file=out)
            if not several:
                print("\n".join(map(str, paths)), file=out)
    return session
