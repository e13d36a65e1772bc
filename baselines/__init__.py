"""The bench: methods that wrap other libraries, published problems and the arena."""

import miho.exports  # noqa: F401 -- answers for former names
