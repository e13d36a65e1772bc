"""Remove passwords and tokens from text before it is stored or shown."""

from __future__ import annotations

import os
import re
from dataclasses import replace

from miho.optim import RunRecord

LOGIN = re.compile(r"(?<=://)[^/\s'\"]+@")
"""The login in a URL, https://user:password@host; its name may be a token."""

SECRET = re.compile(r"SECRET|TOKEN|PASSW|CREDENTIAL|PRIVATE|API_?KEY", re.IGNORECASE)
PLACE = re.compile(r"(?:_FILE|_PATH|_DIR|_URL)$", re.IGNORECASE)
SHORTEST = 8
"""Shortest value of a secret variable that is removed; shorter ones occur as words."""


def names_secret(name: str) -> bool:
    """Return whether the name of a variable or setting indicates a secret value."""
    return bool(SECRET.search(name)) and not PLACE.search(name)


def redacted(text: str) -> str:
    """The text without logins in URLs and without values of secret environment variables."""
    for name, value in os.environ.items():
        if len(value) >= SHORTEST and names_secret(name):
            text = text.replace(value, f"<{name}>")
    return LOGIN.sub("<login>@", text)


def holds_secret(text: str) -> bool:
    """Return whether `redacted` would change the text."""
    return redacted(text) != text


def without_secrets(record: RunRecord) -> RunRecord:
    """The record with redacted texts: a user's model may raise any message."""
    error = None if record.error is None else redacted(record.error)
    rejected: dict[str, int] = {}
    for reason, times in record.rejected.items():
        rejected[redacted(reason)] = rejected.get(redacted(reason), 0) + times
    return replace(record, error=error, rejected=rejected)
