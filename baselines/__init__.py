"""Methods that wrap other libraries, and published problems."""

import miho.moved  # noqa: F401 -- answers for former names
