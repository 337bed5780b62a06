# Every target first creates the virtual environment if it does not exist.
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DEV_STAMP := $(VENV)/.dev
DOCS_STAMP := $(VENV)/.docs
TRITON_STAMP := $(VENV)/.triton
ARGS ?=
# The build of torch that everything is resolved for.
TORCH ?= $(shell grep '^torch==' constraints.txt)
# auto takes torch's CPU build unless there is a GPU; or choose one: make setup TORCH_BACKEND=cu130
TORCH_BACKEND ?= auto
# for UV's redirection
SHELL := bash
# uv is fast and finds the builds of torch; where it cannot reach them, pip installs its default.
# What it downloads is shown, not the list of what it installed.
UV := 2> >(grep --line-buffered -v '^ [-+~] ' >&2) $(BIN)/uv pip install --python $(BIN)/python -c constraints.txt
PIP := PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet -c constraints.txt
# The first of these that is Python 3.11 to 3.14; or choose one: make setup PYTHON=/path/to/python3.13
PYTHON ?= $(shell for p in python3 python3.11 python3.12 python3.13 python3.14; do \
	$$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 15))' 2>/dev/null \
	&& { echo $$p; break; }; done)
# Tests that need CUDA are skipped without it.
MARKERS ?= not slow and not smoke
# tests/conftest.py chooses the number of processes; files keep their order.
PROCESSES ?= -n auto --maxprocesses 4
PARALLEL ?= $(PROCESSES) --dist loadfile --no-loadscope-reorder

.PHONY: help constraints coverage setup demo train test test-gpu test-all smoke docs check bench validate validate-quick format clean

help: ## list the targets
	@grep -E '^[a-z-]+:.*## ' $(firstword $(MAKEFILE_LIST)) | sed -E 's/:.*## /\t/' | expand -t 16

setup: $(DEV_STAMP) ## install everything into .venv, also what tests and exports need

# torch is installed first and pinned, so that no dependency replaces its build.
$(STAMP): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "no Python 3.11 to 3.14 found: install one, or set PYTHON=..."; exit 1; }
	@echo "setting up $(VENV) with $(PYTHON), once"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(PIP) uv
	@echo "1/2 torch, $(TORCH_BACKEND): 0.8 GB on the disk for a CPU, several GB for a GPU"
	@$(UV) --torch-backend=$(TORCH_BACKEND) "$(TORCH)" || \
		{ echo "uv cannot reach the builds of torch: pip takes its default, on Linux that for a GPU"; $(PIP) "$(TORCH)"; }
	@echo "2/2 everything else: 1.2 GB"
	@$(UV) -e . || $(PIP) -e .
	@touch $@

$(DEV_STAMP): $(STAMP)
	@echo "installing what tests, exports and sweeps need: 1.1 GB, once"
	@$(UV) -e '.[dev]' || $(PIP) -e '.[dev]'
	@touch $@

train: $(STAMP) ## train a policy to catch moving food on a coarse grid; ARGS="seed=1 ..." sets any setting
	$(BIN)/fishrl train $(if $(filter resume=% preset=% task=%,$(ARGS)),,preset=quick $(if $(filter total_frames=%,$(ARGS)),,total_frames=4900)) $(ARGS)

demo: $(STAMP) ## film trained policies that catch food and hold station
	$(BIN)/fishrl demo $(ARGS)

test: $(DEV_STAMP) ## run the tests, including a short training; ARGS="tests/physics" selects some
	$(BIN)/python -m pytest $(PARALLEL) -m "$(MARKERS)" $(ARGS)

# Triton comes with torch's builds for CUDA; elsewhere it runs and compiles their kernels on the host.
$(TRITON_STAMP): $(DEV_STAMP)
	@$(UV) -e '.[triton]' || $(PIP) -e '.[triton]'
	@touch $@

GPU_MARKERS ?= (gpu or smoke) and not slow
GPU_FOLDERS := tests/gpu tests/smoke tests/physics/fast tests/viewer

test-gpu: $(TRITON_STAMP) ## run the GPU and smoke tests on a GPU, or an emulated one where there is none
	PRETEND_CUDA=1 SMOKE_DEVICE=cuda PYTHONPATH=tests/pretend $(BIN)/python \
		-m pytest $(PROCESSES) --dist loadgroup --no-loadscope-reorder \
		-m "$(GPU_MARKERS)" $(ARGS) $(GPU_FOLDERS)

test-all: $(DEV_STAMP) ## run all tests, including the slow ones and those of make smoke
	$(BIN)/python -m pytest $(ARGS)

smoke: $(DEV_STAMP) ## run each task, algorithm and program for a few steps, under 90 s
	$(BIN)/python -m pytest $(PROCESSES) -m "smoke and not slow" $(ARGS)

$(DOCS_STAMP): $(DEV_STAMP)
	@$(UV) -e '.[docs]' || $(PIP) -e '.[docs]'
	@touch $@

docs: $(DOCS_STAMP) ## build the documentation into build/docs; warnings are errors
	$(BIN)/python -m sphinx -W --keep-going -b html docs build/docs

# pip-compile resolves all extras for this Python; the builds of torch differ between machines, so its version is given.
constraints: ## rewrite constraints.txt with the newest versions that pyproject.toml allows; TORCH=torch==2.14.1
	@$(PYTHON) -m venv build/pip-tools && build/pip-tools/bin/python -m pip install --quiet pip-tools
	@echo "$(TORCH)" > build/pip-tools/torch.txt
	@build/pip-tools/bin/pip-compile --quiet --all-extras --allow-unsafe --no-annotate --no-header --strip-extras \
		--no-emit-index-url --no-emit-find-links --no-emit-trusted-host \
		--constraint build/pip-tools/torch.txt --output-file build/pip-tools/pins.txt pyproject.toml
	@{ grep '^#' constraints.txt; grep -E '^[A-Za-z0-9_.-]+==' build/pip-tools/pins.txt; } > build/pip-tools/new.txt
	@mv build/pip-tools/new.txt constraints.txt

coverage: $(DEV_STAMP) ## run the tests and report which lines of fishrl they miss, in build/coverage
	$(BIN)/python -m pytest $(PARALLEL) -m "$(MARKERS)" --cov=fishrl --cov-report=term:skip-covered --cov-report=html:build/coverage $(ARGS)

check: $(DEV_STAMP) ## lint, formatting, types, import rules
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -q tests/test_architecture.py

bench: $(DEV_STAMP) ## run the benchmarks, about ten minutes; ARGS="groups=[solver,coupled]" selects some
	$(BIN)/python -m experiments.benchmark $(ARGS)

validate: $(DEV_STAMP) ## compare the solver with the literature; write docs/validation.md and its results
	$(BIN)/python -m experiments.validate $(ARGS)

validate-quick: $(DEV_STAMP) ## coarse cases only, some three minutes with empty caches; the page goes to runs/validation
	$(BIN)/python -m experiments.validate quick=true $(ARGS)

format: $(DEV_STAMP) ## format the code
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean: ## remove environment and caches, keep runs/
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
