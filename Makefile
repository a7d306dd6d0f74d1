# Two commands set tianim up: `make demo` and `make test`. `make help` lists the others.
#   make demo PYTHON=python3.12    with another Python (3.10 to 3.13)

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --no-input

# Short tests of the kernels, for a second compiler.
QUADRANTS_TESTS := tests/physics/test_every_system.py tests/physics/test_gravity_forces.py \
  tests/physics/test_fluid_pressure.py tests/unit/test_fluid_pairs.py tests/unit/test_grid.py \
  tests/unit/test_octree.py tests/unit/test_springs_hinges.py tests/unit/test_springs_limits.py

# A process for each core, each with whole files: cases of one file share what they compute.
TOGETHER := -n auto --maxprocesses 4 --dist loadfile

SCENES := $(basename $(notdir $(wildcard configs/*.yaml)))

.NOTPARALLEL:
.DEFAULT_GOAL := help
.PHONY: help demo test test-slow test-quadrants lint format gallery constraints clean

help: ## This list
	@sed -nE 's/^([a-z-]+):.*## (.*)/make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 24

demo: $(VENV)/all.stamp ## Install, fly 30,000 starlings, make frames, pictures and a film
	$(BIN)/tianim run configs/murmuration.yaml --out out/demo --overwrite
	@echo "More scenes: $(BIN)/tianim list"

test: $(VENV)/test.stamp ## Install and run the tests
	$(BIN)/python -m pytest $(TOGETHER) $(ARGS)

test-slow: $(VENV)/test.stamp ## The tests that take minutes
	$(BIN)/python -m pytest $(TOGETHER) -m slow $(ARGS)

test-quadrants: $(VENV)/test.stamp ## Short tests of the kernels under the other compiler
	TIANIM_COMPILER=quadrants $(BIN)/python -m pytest $(TOGETHER) $(QUADRANTS_TESTS) $(ARGS)

lint: $(VENV)/dev.stamp ## Style and types
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy tianim

format: $(VENV)/dev.stamp ## Mend the style
	$(BIN)/ruff check --fix-only
	$(BIN)/ruff format

gallery: $(VENV)/all.stamp ## Make the pictures of the README anew
	mkdir -p docs/images
	for scene in $(SCENES); do \
	  $(BIN)/tianim run $$scene --out out/gallery/$$scene --overwrite || exit; \
	  cp out/gallery/$$scene/preview.png docs/images/$$scene.png; \
	done
	$(BIN)/python demos/gust.py && cp out/gust/preview.png docs/images/gust.png

constraints: ## Pin anew; needs python3.10 to python3.13
	$(PYTHON) tools/constraints.py python3.10 python3.11 python3.12 python3.13

clean: ## Remove the virtual environment and caches; results in out/ stay
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find tianim tests tools demos -name __pycache__ -prune -exec rm -rf {} +

# One stamp for each set of extras of pyproject.toml; a second call finds it and installs nothing.
$(VENV)/%.stamp: pyproject.toml constraints.txt | $(BIN)/pip
	@echo "tianim: installing into $(VENV) (the first time some 0.4 GB are fetched: minutes on a slow line)"
	$(PIP) install --quiet -c constraints.txt -e ".[$*]"
	@touch $@

# pip comes last when an environment is made, so it stands for a whole one.
$(BIN)/pip:
	@$(PYTHON) tools/machine.py
	@$(PYTHON) -m venv $(VENV)
