# loco-mjx: `make train ENV=mountain`, `make test`, `make help`.
ENV ?= thin
POLICY ?= loco-transformer
SEED ?= 0
STEPS ?=
ARGS ?=
PYTHON ?= python3

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: help setup train test lint bench clean

help:  ## Lists the targets.
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/'

setup: $(STAMP)  ## Makes .venv with everything pinned in constraints.txt.

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@touch $(STAMP)

train: $(STAMP)  ## Trains POLICY on ENV, e.g. make train ENV=mountain POLICY=loco-transformer SEED=0 STEPS=1000000.
	$(BIN)/loco-mjx train --task $(ENV) --policy $(POLICY) --seed $(SEED) $(if $(STEPS),--total-steps $(STEPS)) $(ARGS)

test: $(STAMP)  ## Runs the whole test suite.
	$(BIN)/python -m pytest $(ARGS)

lint: $(STAMP)  ## Style and types.
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(STAMP)  ## Measures depth, physics, environment and training speed on ENV.
	$(BIN)/loco-mjx bench depth --task $(ENV) $(ARGS)
	$(BIN)/loco-mjx bench physics --task $(ENV) $(ARGS)
	$(BIN)/loco-mjx bench env --task $(ENV) $(ARGS)
	$(BIN)/loco-mjx bench train --task $(ENV) --policy $(POLICY) $(ARGS)

clean:  ## Removes .venv and caches; leaves runs/ alone.
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache build dist *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
