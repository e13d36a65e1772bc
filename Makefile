# make compare    the paper's comparison at reduced size: figure and claims table (3 minutes)
# make arena      many methods on many problems: leaderboard, tests, profiles (some two hours)
# make figures    Fig. 4 to 8 from nothing (about 10 minutes)
# make test       the test suite
# make lint       formatter, linter, type checker
# make notebooks  run the notebooks, and keep what they show
# make docs       the manual, into site/
# make install    only the environment
# make lock       pin the versions of this environment
# make clean      remove the environment
# Each target makes its own environment the first time, in .venv unless VENV=... names another
# folder, with python3 unless PYTHON=... names another interpreter.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/installed
DEVELOPED := $(VENV)/developed
DOCUMENTED := $(VENV)/documented

# Without build isolation nothing is downloaded twice. Libraries are compiled where they are imported;
# our own modules are compiled first, since numba, which drives use, takes code from sources and from
# bytecode for two.
PIP := $(BIN)/python -m pip install -qq --no-compile --no-build-isolation --constraint constraints.txt
# A process that has no tests left takes some of the other one's.
PYTEST := $(BIN)/python -m pytest -q -n auto --dist worksteal

# With it every process is made from the sources again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help install compare arena figures test lint notebooks docs lock clean

help:
	@sed -n 's/^# make /make /p' Makefile

$(INSTALLED): pyproject.toml setup.py constraints.txt $(wildcard miho/core/*.c miho/core/*.h)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "error: Python 3.11 or newer is needed; name it with make PYTHON=...")'
	@echo "$(VENV): an environment for $$($(PYTHON) --version)"
	@$(PYTHON) -m venv $(VENV)
	@echo "$(VENV): NumPy, SciPy, Numba and pandas, which take most of the room"
	@$(PIP) numpy scipy numba pandas setuptools
	@echo "$(VENV): matplotlib, Hydra, Optuna and what else MIHO is run with"
	@$(PIP) --editable '.[experiments]'
	@$(BIN)/python -m compileall -q miho baselines experiments
	@$(SIZE)
	@touch $@

$(DEVELOPED): $(INSTALLED)
	@echo "$(VENV): pytest, mypy, Jupyter's kernel and what else MIHO is developed with"
	@$(PIP) --editable '.[experiments,dev]'
	@$(SIZE)
	@touch $@

$(DOCUMENTED): $(INSTALLED)
	@echo "$(VENV): MkDocs and what reads docstrings and notebooks"
	@$(PIP) --editable '.[experiments,docs]'
	@touch $@

SIZE = du -sk $(VENV)/lib/python*/site-packages/* | sort -rn | awk ' \
	{ total += $$1; n = split($$2, path, "/") } \
	NR <= 5 { largest = largest sprintf(", %s %.0f", path[n], $$1 / 1024) } \
	END { printf "$(VENV): %.0f MB%s ...\n", total / 1024, largest }'

install: $(INSTALLED)

compare: $(INSTALLED)
	$(BIN)/python -m experiments.compare

arena: $(INSTALLED)
	@echo "$(VENV): rivals whose libraries are heavy"
	@$(PIP) --editable '.[experiments,rivals]'
	$(BIN)/python -m experiments.compare experiment=arena

figures: $(INSTALLED)
	$(BIN)/python -m experiments.identify -m dataset=tire_lf,tire_rf,tire_lr,tire_rr optimizer=miho
	$(BIN)/python -m experiments.identify -m dataset=torque_05,torque_15,torque_20 optimizer=miho
	$(BIN)/python -m experiments.figures fig4
	$(BIN)/python -m experiments.figures fig5
	$(BIN)/python -m experiments.compare
	$(BIN)/python -m experiments.drive experiment=ims_obstacle
	$(BIN)/python -m experiments.drive experiment=lvms_laps

test: $(DEVELOPED)
	$(PYTEST)

lint: $(DEVELOPED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: $(DOCUMENTED)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

notebooks: $(DEVELOPED)
	$(BIN)/python -m experiments.notebooks

lock: $(DEVELOPED)
	$(BIN)/python -m pip freeze --all --exclude pip --exclude-editable > constraints.txt

clean:
	rm -rf $(VENV) build *.egg-info miho/core/*.so
