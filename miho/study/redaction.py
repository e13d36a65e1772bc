"""Passwords and tokens, found in text before it is stored or shown."""

from __future__ import annotations

import os
import re
from dataclasses import replace

from miho.optim import RunRecord

LOGIN = re.compile(r"(?<=://)[^/\s'\"]+@")
"""The login in a URL, whose name can be the token too: https://user:password@host."""

SECRET = re.compile(r"SECRET|TOKEN|PASSW|CREDENTIAL|PRIVATE|API_?KEY", re.IGNORECASE)
PLACE = re.compile(r"(?:_FILE|_PATH|_DIR|_URL)$", re.IGNORECASE)
SHORTEST = 8
"""Shorter values of secret variables are too common as words to be looked for."""


def names_secret(name: str) -> bool:
    """Whether the name of a variable or setting says that its value is secret."""
    return bool(SECRET.search(name)) and not PLACE.search(name)


def redacted(text: str) -> str:
    """The text without logins in URLs and values of environment variables that name a secret."""
    for name, value in os.environ.items():
        if len(value) >= SHORTEST and names_secret(name):
            text = text.replace(value, f"<{name}>")
    return LOGIN.sub("<login>@", text)


def holds_secret(text: str) -> bool:
    """Whether `redacted` would change the text."""
    return redacted(text) != text


def without_secrets(record: RunRecord) -> RunRecord:
    """The record with its texts redacted: a model of the user's may raise anything."""
    error = None if record.error is None else redacted(record.error)
    rejected: dict[str, int] = {}
    for reason, times in record.rejected.items():
        rejected[redacted(reason)] = rejected.get(redacted(reason), 0) + times
    return replace(record, error=error, rejected=rejected)
