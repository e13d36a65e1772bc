"""What a configuration must not hold, because it is stored with the run: secrets."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NoReturn

from omegaconf import OmegaConf

from miho.study.redaction import holds_secret


class SecretError(ValueError):
    """Names where a secret stands, and does not show it."""


def check_no_secret(value: Any, key: str) -> None:
    """Raise SecretError if a text in this resolved part of a configuration holds a secret."""
    texts = list(_texts(value, key))
    if holds_secret("\n".join(text for _, text in texts)):
        place = next((place for place, text in texts if holds_secret(text)), key)
        raise SecretError(
            f"{place}: holds a password or token, which would be stored with the run; remove it"
        )


def refuse_environment() -> None:
    """Make `${oc.env:NAME}` an error in every configuration of this process, Hydra's included."""
    OmegaConf.register_new_resolver("oc.env", _no_environment, replace=True)


def _no_environment(name: str, *_: object) -> NoReturn:
    raise SecretError(
        f"a configuration cannot read the environment variable {name}, which would be stored "
        "with the run; give the value itself"
    )


def _texts(value: Any, key: str) -> Iterator[tuple[str, str]]:
    """Every text, names included, with its key path."""
    if isinstance(value, dict):
        for name, part in value.items():
            yield key, str(name)
            yield from _texts(part, f"{key}.{name}")
    elif isinstance(value, list):
        for index, part in enumerate(value):
            yield from _texts(part, f"{key}[{index}]")
    elif isinstance(value, str):
        yield key, value
