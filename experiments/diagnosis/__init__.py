"""What `doctor` and `faults` check: machine, packages, a folder of runs; the fault table."""
