"""Commands, run from the checkout: Hydra composes the configuration, the library does the work."""
