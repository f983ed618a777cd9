# Wattlane. `make help` lists what there is. Everything is set up on the first call, and kept for the next.
SHELL := bash
.DEFAULT_GOAL := help
py := .venv/bin/python
ARGS ?=

.PHONY: help run bench setup test test-nojit test-slow lint format lock demos clean distclean

help: ## list the targets
	@grep -hE '^[a-z-]+:.*##' Makefile | sed -E 's/^([a-z-]+):.*## /\1\t/' | expand -t 14

run: ## set up, then open the dashboard   (ARGS="--no-browser --port 8051")
	@bash scripts/setup.sh run
	@.venv/bin/wattlane dashboard $(ARGS)

bench: ## set up, then measure rates      (ARGS=--json)
	@bash scripts/setup.sh run
	@.venv/bin/wattlane bench $(ARGS)

setup: ## set everything up, and start nothing
	@bash scripts/setup.sh test

test: setup test-nojit ## set up, then run the test suite     (ARGS="-k judge -x")
	$(py) -m pytest -n 2 --dist loadgroup $(ARGS)

test-nojit: ## the slice of the suite that also runs as plain Python
	@bash scripts/setup.sh lint
	NUMBA_DISABLE_JIT=1 $(py) -m pytest -m "nojit_slice and not slow"

test-slow: setup ## the long studies, left out of `make test`
	$(py) -m pytest -m slow --timeout 3600 $(ARGS)

lint: ## ruff, mypy, hadolint
	@bash scripts/setup.sh lint
	$(py) -m ruff check .
	$(py) -m ruff format --check .
	$(py) -m mypy
	.venv/bin/hadolint Dockerfile

format: ## let ruff repair and format
	@bash scripts/setup.sh lint
	$(py) -m ruff check --fix .
	$(py) -m ruff format .

lock: ## resolve the dependencies anew       (ARGS=--upgrade)
	@bash scripts/lock.sh $(ARGS)

demos: setup ## record the demo runs and the arc times of *Learned time* anew
	$(py) scripts/demos.py
	$(py) scripts/learned_time.py

clean: ## remove caches and what was built
	rm -rf build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks
	find app assets engine tests -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean ## and the environment
	rm -rf .venv
