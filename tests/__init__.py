"""A package, so that processes that tests start find it: some libraries install a `tests` too."""
