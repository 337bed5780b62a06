# Every target makes its own virtual environment first; a second call finds it there.
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DOCS_STAMP := $(VENV)/.docs
ARGS ?=
# Python 3.11: the first of these that is one, or name it: make setup PYTHON=/path/to/python3.11
PYTHON ?= $(shell for p in python3 python3.11; do \
	$$p -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null \
	&& { echo $$p; break; }; done)
# Tests that need CUDA skip themselves where there is none; `make smoke` runs those of its marker.
MARKERS ?= not slow and not smoke
# One process per core; files keep their order, so that physics and environments come first.
PARALLEL ?= -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder

.PHONY: help setup train test test-all smoke docs check bench bench-peers validate validate-quick format clean

help: ## say what there is to make
	@grep -E '^[a-z-]+:.*## ' $(firstword $(MAKEFILE_LIST)) | sed -E 's/:.*## /\t/' | expand -t 16

setup: $(STAMP) ## install everything into .venv

# torch comes first and pinned, so that nothing else can ask for another build of it.
$(STAMP): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "no Python 3.11 found: install it, or name it with PYTHON=..."; exit 1; }
	@echo "setting up $(VENV) with $(PYTHON): a few minutes, once"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "1/2 torch"
	@$(BIN)/python -m pip install --quiet "$$(grep '^torch==' constraints.txt)" -c constraints.txt
	@echo "2/2 everything else"
	@PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet -e '.[dev]' -c constraints.txt
	@touch $@

train: $(STAMP) ## teach a fish to catch its food; ARGS="seed=1 ..." overrides the configuration
	$(BIN)/python -m experiments.train $(ARGS)

test: $(STAMP) ## run the tests, a short training among them; ARGS="tests/physics" narrows
	$(BIN)/python -m pytest $(PARALLEL) -m "$(MARKERS)" $(ARGS)

test-all: $(STAMP) ## run every test, the slow ones and those of make smoke among them
	$(BIN)/python -m pytest $(ARGS)

smoke: $(STAMP) ## every task, every algorithm and every program for a few steps, under 90 s
	$(BIN)/python -m pytest -m smoke $(ARGS)

$(DOCS_STAMP): $(STAMP)
	@PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet -e '.[docs]' -c constraints.txt
	@touch $@

docs: $(DOCS_STAMP) ## build the pages into build/docs; a warning is an error
	$(BIN)/python -m sphinx -W --keep-going -b html docs build/docs

check: $(STAMP) ## lint, formatting, types, who may import whom
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -q tests/test_architecture.py

bench: $(STAMP) ## measure the speed of everything, about ten minutes; ARGS="groups=[solver,coupled]" narrows
	$(BIN)/python -m experiments.benchmark $(ARGS)

bench-peers: $(STAMP) ## install the codes that the benchmark compares with
	$(BIN)/python -m pip install --quiet -e '.[bench]' -c constraints.txt

validate: $(STAMP) ## judge the solver by the literature and write docs/validation.md
	$(BIN)/python -m experiments.validate $(ARGS)

validate-quick: $(STAMP) ## the same, coarse cases only, about a minute; the page goes to runs/validation
	$(BIN)/python -m experiments.validate --quick $(ARGS)

format: $(STAMP) ## put the code into the house style
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean: ## remove the environment and caches; runs/ stays
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
