"""Passwords and tokens are cut out of what is stored."""

from dataclasses import fields, replace

import pytest

from miho import Budget, minimize
from miho.optim import RandomSearch
from miho.study.redaction import holds_secret, redacted, without_secrets
from miho.testing import DecayFit


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("see postgresql://me:w@rd@host:5432/db now", "see postgresql://<login>@host:5432/db now"),
        ("https://token@github.com", "https://<login>@github.com"),
        ("https://example.org/a@b", "https://example.org/a@b"),
        ("me@example.org", "me@example.org"),
    ],
)
def test_logins_in_urls(text: str, expected: str) -> None:
    assert redacted(text) == expected
    assert holds_secret(text) == (text != expected)


def test_values_of_secret_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DB_PASSWORD", "correct-horse")
    monkeypatch.setenv("SHORT_TOKEN", "miho")
    monkeypatch.setenv("TOKEN_FILE", "/run/secrets/token")
    monkeypatch.setenv("PLAIN", "staple-battery")
    text = "correct-horse miho /run/secrets/token staple-battery"
    assert redacted(text) == text.replace("correct-horse", "<DB_PASSWORD>")


def test_a_record(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DB_PASSWORD", "correct-horse")
    record = minimize(RandomSearch(), DecayFit(), Budget(evaluations=10), 0)
    same = without_secrets(record)
    assert all(getattr(same, field.name) is getattr(record, field.name) for field in fields(record)
               if field.name != "rejected")  # fmt: skip
    assert same.rejected == record.rejected
    secret = replace(record, error="no correct-horse", rejected={"a correct-horse": 2, "NaN": 1})
    clean = without_secrets(secret)
    assert clean.error == "no <DB_PASSWORD>"
    assert clean.rejected == {"a <DB_PASSWORD>": 2, "NaN": 1}
    assert clean.trace is secret.trace
