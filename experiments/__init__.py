"""Commands, run from the checkout: Hydra composes, the library runs."""
