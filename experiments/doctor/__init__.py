"""`python -m experiments.doctor`: is this machine, this installation, this results folder sound."""
