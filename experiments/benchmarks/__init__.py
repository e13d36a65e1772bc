"""Measurements of speed by command, never as tests: `python -m experiments.benchmarks.NAME`."""
