# `make demo` and `make test` are all that a fresh machine needs: Python 3.11+ and make.
# The environment lies in .venv; stamp files keep a second run quick.

PYTHON ?= python3
DURATION ?= 30
SCENARIO ?= quad_mission
PYTEST_ARGS ?=

VENV := .venv
BIN := $(VENV)/bin
# A client of the acceptance tests, without its needs for maps and video.
MAVPROXY = $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps 'MAVProxy>=1.8.75'

.PHONY: help demo test lint bench clean

help:
	@echo "make demo [DURATION=30]   the service and the simulator against each other"
	@echo "make test                 all tests"
	@echo "make lint                 ruff, mypy, import-linter"
	@echo "make bench                the figures of the README"
	@echo "make clean                removes .venv and what was built"
	@echo "PYTHON=python3.12 chooses the interpreter for .venv"

demo: $(VENV)/.core
	@$(BIN)/python -m mavins demo --duration $(DURATION) --scenario $(SCENARIO)

test: $(VENV)/.test
	$(BIN)/python -m pytest $(PYTEST_ARGS)

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Every script of tests/bench/ that is called bench_*.py prints its own table.
bench: $(VENV)/.test
	@set -e; for script in tests/bench/bench_*.py; do echo "== $$script"; $(BIN)/python $$script; done

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV)/.made:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "mavins needs Python 3.11 or newer; '$(PYTHON)' is $$($(PYTHON) --version 2>&1)."; \
	  echo "Name another one: make PYTHON=python3.12 ..."; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { \
	  echo "'$(PYTHON) -m venv' failed; on Debian or Ubuntu: apt install python3-venv"; exit 1; }
	@touch $@

# pip is asked for its errors only, so that the demo's own lines stay in sight.
$(VENV)/.core: pyproject.toml | $(VENV)/.made
	@echo "installing mavins into $(VENV) ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	@touch $@

$(VENV)/.test: pyproject.toml | $(VENV)/.made
	@echo "installing mavins with its tests' needs into $(VENV) ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[report,test,acceptance]'
	@$(MAVPROXY)
	@touch $@ $(VENV)/.core

$(VENV)/.dev: pyproject.toml | $(VENV)/.made
	@echo "installing mavins with its linters into $(VENV) ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev,acceptance]'
	@$(MAVPROXY)
	@touch $@ $(VENV)/.core $(VENV)/.test
