# Every target sets up what it needs by itself, in .venv (others: make VENV=... PYTHON=...).
#
#   make demo    solve the barrel roll, verify, plot and film it, into results/
#   make test    everything that is checked before a merge; ends with pytest's summary
#   make lint    ruff, mypy, import-linter
#   make docs    the documentation, into site/
#   make bench   time the solver, and Crocoddyl; draws what docs/benchmarks.md shows
#   make bench-native  time both compiled for the same processors; builds Crocoddyl from source, into .native-crocoddyl
#   make sanitize  the compiled solver, on all examples, and the receding horizon, under AddressSanitizer and
#                  UndefinedBehaviorSanitizer
#   make valgrind  and under memcheck; the small problems are in make test

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

# Material for MkDocs announces its successor at every build.
export NO_MKDOCS_2_WARNING := 1

.NOTPARALLEL:
.DEFAULT_GOAL := help
.PHONY: help demo test test-slow lint format docs bench bench-native sanitize valgrind clean

help:
	@sed -n '/^#  /s/^# *//p' Makefile

# ------------------------------------------------------------------------------------------------------ environments
# Filled as far as a target needs, and again when pyproject.toml changes.

PIP_INSTALL := $(BIN)/python -m pip install -qq --disable-pip-version-check

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)
	@echo 'Installing into $(VENV); the first time this takes a minute or two.'

$(VENV)/core.stamp: pyproject.toml | $(BIN)/python
	$(PIP_INSTALL) --editable .
	@touch $@

$(VENV)/dev.stamp: pyproject.toml | $(BIN)/python
	$(PIP_INSTALL) --editable '.[dev]'
	@touch $@ $(VENV)/core.stamp

# Crocoddyl wants its own version of pin, so benchmarks have an environment of their own.
$(VENV)-bench/bench.stamp: pyproject.toml
	$(PYTHON) -m venv $(VENV)-bench
	$(VENV)-bench/bin/python -m pip install -qq --disable-pip-version-check --editable '.[bench]'
	@touch $@

# ------------------------------------------------------------------------------------------------------------ targets

demo: $(VENV)/core.stamp
	@mkdir -p results
	$(BIN)/piaffe solve examples/barrel_roll.py --save results/barrel_roll.npz
	$(BIN)/piaffe verify results/barrel_roll.npz examples/barrel_roll.py
	$(BIN)/piaffe plot results/barrel_roll.npz -o results/barrel_roll.png
	$(BIN)/piaffe video results/barrel_roll.npz -o results/barrel_roll.mp4 || echo 'No film this time; all else is there.'
	@ls results

test: lint
	$(BIN)/python -m pytest -n 2 --dist loadfile -m 'not slow'

test-slow: lint
	$(BIN)/python -m pytest -n 2 --dist loadfile

lint: $(VENV)/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

format: $(VENV)/dev.stamp
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(VENV)/dev.stamp
	$(BIN)/mkdocs build --strict

bench: $(VENV)-bench/bench.stamp
	$(VENV)-bench/bin/python benchmarks/solve.py
	$(VENV)-bench/bin/python benchmarks/vs_crocoddyl.py --save
	$(VENV)-bench/bin/python benchmarks/cascade.py --save
	$(VENV)-bench/bin/python benchmarks/scaling.py --save
	$(VENV)-bench/bin/python benchmarks/cold_start.py --save
	$(VENV)-bench/bin/python benchmarks/contacts.py --save
	$(VENV)-bench/bin/python benchmarks/plan_time.py --save
	$(VENV)-bench/bin/python benchmarks/figures.py

bench-native: $(VENV)-bench/bench.stamp
	$(VENV)-bench/bin/python benchmarks/like_for_like.py --save
	$(VENV)-bench/bin/python benchmarks/figures.py like_for_like

sanitize: $(VENV)/dev.stamp
	$(BIN)/python -m tests.solvers.ilqr.native.memory sanitizers
	$(BIN)/python -m tests.solvers.receding.memory

valgrind: $(VENV)/dev.stamp
	$(BIN)/python -m tests.solvers.ilqr.native.memory valgrind

clean:
	rm -rf build dist site src/piaffe.egg-info .mypy_cache .pytest_cache .ruff_cache .import_linter_cache
