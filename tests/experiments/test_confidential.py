"""Secrets do not get into a configuration, nor into the message that says so."""

import pytest
from omegaconf import OmegaConf
from omegaconf.errors import InterpolationResolutionError

from experiments.app.build import ConfigError, build
from experiments.app.compose import composed
from experiments.app.safety import SecretError, check_no_secret, check_typed

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
    with pytest.raises(SecretError, match=f"^{place}: contains a password or token") as caught:
        check_no_secret(value, "key")
    for word in (SECRET, "word@", "ghp_"):
        assert word not in str(caught.value)


def test_what_is_no_secret_passes() -> None:
    for value in ("lf", "https://example.org/x@2", "a@b.org", "m/s^2", ["x", {"y": 3.0}], None):
        check_no_secret(value, "key")


def test_a_variable_with_a_secret_cannot_be_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ANY_TOKEN", SECRET)
    for text in ("${oc.env:ANY_TOKEN}", "${oc.env:ANY_TOKEN,lf}", "a${oc.env:ANY_TOKEN}b"):
        with pytest.raises(
            InterpolationResolutionError, match="environment variable ANY_TOKEN"
        ) as e:
            OmegaConf.to_container(OmegaConf.create({"a": text}), resolve=True)
        assert SECRET not in str(e.value)


def test_other_variables_are_read_as_omegaconf_reads_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("A_TIRE", "rf")
    monkeypatch.delenv("NO_TIRE", raising=False)
    given = {"a": "${oc.env:A_TIRE}", "b": "${oc.env:NO_TIRE,lf}", "c": "${oc.env:NO_TIRE,null}"}
    found = OmegaConf.to_container(OmegaConf.create(given), resolve=True)
    assert found == {"a": "rf", "b": "lf", "c": None}
    with pytest.raises(InterpolationResolutionError, match="NO_TIRE"):
        OmegaConf.to_container(OmegaConf.create({"a": "${oc.env:NO_TIRE}"}), resolve=True)


@pytest.mark.parametrize(
    "text",
    ["+dataset.password=x", "+token=x", "a.api_key=x", "root=https://me:word@host/x", "seed=$"],
)
def test_what_hydra_would_write_down_is_checked_before(
    monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    monkeypatch.setenv("SOME_API_KEY", SECRET)
    with pytest.raises(SecretError, match="contains a password or token") as caught:
        check_typed(["dataset=tire_lf", text.replace("$", SECRET)])
    assert SECRET not in str(caught.value)
    check_typed(["dataset.tire=lf", "root=runs/x", "+space.a={unit: V, low: 0, high: 1}"])


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["dataset.tire=https://me:word@host/lf.tir"], "dataset.tire: contains a password"),
        (["root=https://me:word@host/runs"], "root: contains a password"),
        (["root=' '"], "root: is ' '; expected the path"),
        (["problem.name=https://me:word@host"], "problem.name: contains a password"),
    ],
)
def test_a_build_refuses_them(overrides: list[str], words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        build(composed(overrides))
    assert "word@" not in str(caught.value)
