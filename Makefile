# make compare   the paper's comparison at reduced size: figure and claims table (3 minutes)
# make arena     many methods on many problems: leaderboard, tests, profiles (41 minutes)
# make figures   Fig. 4, 5 and 6 from nothing (6 to 10 minutes)
# make test      the test suite
# make lint      formatter, linter, type checker
# make install   only the environment
# make lock      pin the versions of this environment
# make clean     remove the environment
# Each target makes its own environment in .venv the first time.

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/installed

# With it every process, and every compiled loss, is made from the sources again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help install compare arena figures test lint lock clean

help:
	@sed -n 's/^# //p' Makefile

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "error: Python 3.11 or newer is needed; name it with make PYTHON=...")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[experiments,dev]'
	$(BIN)/python -m compileall -q miho baselines experiments
	touch $@

install: $(INSTALLED)

compare: $(INSTALLED)
	$(BIN)/python -m experiments.compare

arena: $(INSTALLED)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[experiments,rivals]'
	$(BIN)/python -m experiments.compare experiment=arena

figures: $(INSTALLED)
	$(BIN)/python -m experiments.identify -m dataset=tire_lf,tire_rf,tire_lr,tire_rr optimizer=miho
	$(BIN)/python -m experiments.identify -m dataset=torque_05,torque_15,torque_20 optimizer=miho
	$(BIN)/python -m experiments.figures fig4
	$(BIN)/python -m experiments.figures fig5
	$(BIN)/python -m experiments.compare

test: $(INSTALLED)
	$(BIN)/python -m pytest -q -n auto

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

lock: $(INSTALLED)
	$(BIN)/python -m pip freeze --all --exclude pip --exclude-editable > constraints.txt

clean:
	rm -rf .venv build *.egg-info
