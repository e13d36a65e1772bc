"""The bench: methods that wrap other libraries, published problems and the arena."""

import miho.moved  # noqa: F401 -- answers for former names
