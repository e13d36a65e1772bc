"""Secrets do not get into a configuration, nor into the message that says so."""

import pytest
from omegaconf import OmegaConf
from omegaconf.errors import InterpolationResolutionError

from experiments.app.build import ConfigError, build
from experiments.app.compose import composed
from experiments.app.safety import SecretError, check_no_secret
from experiments.app.schema import register

register()
SECRET = "correct-horse-battery"


@pytest.mark.parametrize(
    ("value", "place"),
    [
        ({"a": {"b": ["x", f"see {SECRET}"]}}, r"key.a.b\[1\]"),
        ({"uri": "postgresql://me:word@host/db"}, r"key.uri"),
        ({"uri": "https://ghp_0123456789@github.com"}, r"key.uri"),
        ({SECRET: 1}, "key"),
    ],
)
def test_a_secret_is_refused_and_not_shown(
    monkeypatch: pytest.MonkeyPatch, value: object, place: str
) -> None:
    monkeypatch.setenv("SOME_API_KEY", SECRET)
    with pytest.raises(SecretError, match=f"^{place}: holds a password or token") as caught:
        check_no_secret(value, "key")
    for word in (SECRET, "word@", "ghp_"):
        assert word not in str(caught.value)


def test_what_is_no_secret_passes() -> None:
    for value in ("lf", "https://example.org/x@2", "a@b.org", "m/s^2", ["x", {"y": 3.0}], None):
        check_no_secret(value, "key")


def test_the_environment_cannot_be_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ANYTHING", SECRET)
    for text in ("${oc.env:ANYTHING}", "${oc.env:ANYTHING,lf}", "a${oc.env:ANYTHING}b"):
        with pytest.raises(
            InterpolationResolutionError, match="environment variable ANYTHING"
        ) as e:
            OmegaConf.to_container(OmegaConf.create({"a": text}), resolve=True)
        assert SECRET not in str(e.value)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["dataset.tire=https://me:word@host/lf.tir"], "dataset.tire: holds a password"),
        (["root=https://me:word@host/runs"], "root: holds a password"),
        (["root=' '"], "root: is ' '; expected the path"),
        (["problem.name=https://me:word@host"], "problem.name: holds a password"),
    ],
)
def test_a_build_refuses_them(overrides: list[str], words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        build(composed(overrides))
    assert "word@" not in str(caught.value)
