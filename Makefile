# Everything a newcomer needs: `make demo`, `make test`. `make help` lists the rest.

SHELL := /bin/bash
VENV ?= .venv
# The first of these that runs; pyenv has names on the PATH that do not.
PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3; do \
	$$p -c "" 2>/dev/null && { command -v $$p; break; }; done)
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
# tests/conftest.py says which tests stay in one process, and which begin.
PYTEST := $(BIN)/python -m pytest --numprocesses auto

.DEFAULT_GOAL := help
.PHONY: help demo test guides lint paper clean

help: ## show this list
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## (.*)/  make \1\t\2/' | expand -t 20

demo: $(VENV)/.installed ## plan, simulate and check the cliff; leaves logs/cliff-<time>/
	$(BIN)/twin run scenarios/lego/cliff.yaml

test: $(VENV)/.installed-dev ## run the tests; lists the ten slowest
	$(PYTEST) -m 'not expensive' --durations=10

guides: $(VENV)/.installed-dev ## run the commands of the guides that take longer
	$(PYTEST) -m expensive --durations=10

lint: $(VENV)/.installed-dev ## check style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

paper: $(VENV)/.installed ## measure the tables of both papers, PUBLISHED=ROOT the published tasks, too; resumable
	$(BIN)/python -m benchmarks.apex_mr $(if $(PUBLISHED),--published "$(PUBLISHED)")
	$(BIN)/python -m benchmarks.construction

clean: ## remove the environment, caches and runs
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis build dist
	find . -name __pycache__ -type d -not -path './$(VENV)/*' -prune -exec rm -rf {} +
	find logs -mindepth 1 -maxdepth 1 -not -name README.md -exec rm -rf {} +

# The stamps make a second `make` skip the installation until its inputs change.

$(VENV)/.created:
	@test -n "$(PYTHON)" || { echo "No python3 found: install Python 3.11, 3.12 or 3.13." >&2; exit 1; }
	@$(PYTHON) .ci/check_python.py
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/.installed: $(VENV)/.created pyproject.toml constraints.txt
	@echo "Installing into $(VENV) (some minutes the first time) ..."
	$(PIP) install --constraint constraints.txt --editable .
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(PIP) install --constraint constraints.txt --editable '.[dev]'
	@touch $@
