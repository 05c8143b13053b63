# SPDX-License-Identifier: Apache-2.0
# Each target works from a fresh clone: it sets up what is missing first.
SHELL := /bin/bash
# Every node is a process: without bytecode caches, which some images turn off, each compiles for seconds at its start.
ACTIVATE := unset PYTHONDONTWRITEBYTECODE; . ./env.sh &&
PYTEST := pytest --numprocesses auto --maxprocesses 8 --dist loadfile --no-loadscope-reorder # a file's tests share fixtures

.PHONY: help setup demo test test-all check bench clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' $(MAKEFILE_LIST)

setup: ## make .venv and build the messages and the package (again: nothing to do)
	@scripts/setup

demo: setup ## replay the sample recordings of two vehicles and report
	@$(ACTIVATE) uav-vslam demo

test: setup ## run the tests but the slow ones on all cores; ARGS="-k camera" chooses
	@$(ACTIVATE) $(PYTEST) -m "not slow" $(ARGS)

test-all: setup ## run all tests, as CI does
	@$(ACTIVATE) $(PYTEST) $(ARGS)

check: setup ## lint, formatting, types
	@$(ACTIVATE) status=0; ruff check . || status=1; ruff format --check . || status=1; mypy || status=1; exit $$status

bench: setup ## measure speed
	@$(ACTIVATE) uav-vslam bench

clean: ## remove what was built and cached; .venv and results stay
	rm -rf build install log .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -path ./.venv -prune -o -name __pycache__ -type d -exec rm -rf {} +
