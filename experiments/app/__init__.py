"""What the commands share: from a command line to runs, with Hydra, and back to exit codes."""
