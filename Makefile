# loco-mjx: `make train ENV=mountain`, `make test`, `make help`.
ENV ?= thin
ROBOT ?= a1
POLICY ?= loco-transformer
# Without a GPU, a policy that sees has a teacher first: docs/results.md has what that gains. METHOD=ppo is the paper's way.
METHOD ?= $(if $(filter state-only privileged,$(POLICY)),ppo,$(if $(shell command -v nvidia-smi),ppo,distill))
SEED ?= 0
STEPS ?=
TASKS ?= thin,wide
POLICIES ?= loco-transformer,state-only
SEEDS ?= 0-4
OUT ?= runs/sweep
SCALE ?= 1
ARGS ?=
DEMO ?= mountain
PYTHON ?= python3

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: help setup demo train sweep paper test lint bench versions clean

help:  ## Lists the targets.
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/'

setup: $(STAMP)  ## Makes .venv with everything pinned in constraints.txt.

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@touch $(STAMP)

demo: $(STAMP)  ## Shows a trained policy, DEMO=mountain, that comes with the package: in the browser; without a display, as a film.
ifeq ($(DISPLAY)$(WAYLAND_DISPLAY)$(filter Darwin,$(shell uname)),)
	$(BIN)/loco-mjx play $(DEMO) --video $(DEMO).mp4 --overwrite $(ARGS)
else
	$(BIN)/loco-mjx play $(DEMO) --web $(ARGS)
endif

train: $(STAMP)  ## Trains POLICY on ENV by METHOD (ppo or distill), e.g. make train ENV=mountain ROBOT=go2 SEED=0 STEPS=1000000.
	$(BIN)/loco-mjx train --task $(ENV) --robot $(ROBOT) --policy $(POLICY) --method $(METHOD) --seed $(SEED) $(if $(STEPS),--total-steps $(STEPS)) $(ARGS)

sweep: $(STAMP)  ## Trains and evaluates POLICIES on TASKS with SEEDS into OUT, e.g. make sweep TASKS=thin SEEDS=0-1 STEPS=1000000.
	$(BIN)/loco-mjx sweep --tasks $(TASKS) --policies $(POLICIES) --seeds $(SEEDS) --out $(OUT) $(if $(STEPS),--total-steps $(STEPS)) $(ARGS)

paper: $(STAMP)  ## Runs the paper's experiments, or goes on; SCALE=0.01 is a hundredth of the samples.
	$(BIN)/python -m experiments.paper --scale $(SCALE) $(ARGS)

test: $(STAMP)  ## Runs the whole test suite.
	$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder $(ARGS)

lint: $(STAMP)  ## Style, types, and which room imports which.
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

bench: $(STAMP)  ## Measures depth, physics, environment and training speed on ENV.
	$(BIN)/loco-mjx bench depth --task $(ENV) --robot $(ROBOT) $(ARGS)
	$(BIN)/loco-mjx bench physics --task $(ENV) --robot $(ROBOT) $(ARGS)
	$(BIN)/loco-mjx bench env --task $(ENV) --robot $(ROBOT) $(ARGS)
	$(BIN)/loco-mjx bench train --task $(ENV) --robot $(ROBOT) --policy $(POLICY) $(ARGS)

versions: $(STAMP)  ## Tries the oldest and the newest versions of Python and JAX, and writes docs/versions.md; takes an hour.
	$(BIN)/python -m experiments.versions $(ARGS)

clean:  ## Removes .venv and caches; leaves runs/ alone.
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache build dist *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
