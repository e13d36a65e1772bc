"""Checks of `doctor` (machine, packages, a folder of runs), and the fault table of `faults`."""
