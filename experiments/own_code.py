"""Models that are code of the user's, which run in processes of their own."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from miho.study import Identity
from miho.study.identity import sha256

NAMELESS = "model"


def runs_own_code(cfg: DictConfig) -> bool:
    """Whether building this configuration runs a file of the user's."""
    return OmegaConf.select(cfg, "model.path", throw_on_missing=False) is not None


def code_of(cfg: DictConfig) -> str:
    """SHA-256 of the model's file; of nothing if there is none."""
    path = Path(cfg.model.path)
    return sha256(path.read_bytes() if path.is_file() else b"")


def named_only(cfg: DictConfig, code: str) -> Identity:
    """Who a run is whose model cannot be asked for its name: the file's stands for it."""
    path, config = Path(cfg.model.path), OmegaConf.to_container(cfg, resolve=True)
    about = {"optimizer": cfg.optimizer.name, "seed": 0, "config": config, "code": code, "data": ""}
    try:
        return Identity(path.stem, **about)
    except ValueError:  # a name that no folder can have
        return Identity(NAMELESS, **about)
