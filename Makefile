# The one place that says how the project is installed, tried, tested and measured.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
LOWEST := .venv-lowest
INSTALLED := $(VENV)/.installed
RESULTS ?= results
# One more than the cores, since tests wait for Ray, a store and a browser, too.
PROCESSES ?= $(shell $(PYTHON) -c 'import os; print(len(os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else range(os.cpu_count())) + 1)')
SEED ?= 1
INJECTIONS ?= 20
VERSION = $(shell $(BIN)/python -c 'import tma_ray; print(tma_ray.__version__)')
# Tests start many processes, none of which has to compile our modules again.
unexport PYTHONDONTWRITEBYTECODE
OPTIONS := --costs 10 --randomly-seed $(SEED)
PYTEST := $(BIN)/python -m pytest $(OPTIONS)
FAST := "not slow and not chaos and not clusters"
SIDE_BY_SIDE := --numprocesses $(PROCESSES) --dist loadscope --no-loadscope-reorder

.DEFAULT_GOAL := help
.PHONY: help install quickstart test test-lowest test-slow test-chaos test-clusters attack static pages docs docs-version \
	check bench lock

help: ## show this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/:/' | column -t -s ':'

install: $(INSTALLED) ## make the virtual environment .venv with everything in it

$(INSTALLED): pyproject.toml requirements.lock # holds how many seconds the installation took
	@mkdir -p $(VENV) && date +%s > $(VENV)/.started
	@echo "Creating the virtual environment $(VENV): a few seconds"
	@$(PYTHON) -m venv $(VENV)
	@echo "Downloading and installing $$(grep -c == requirements.lock) packages: 1 to 5 minutes for some 800 MB, torch the largest (3 GB with CUDA)"
	@$(BIN)/python -m pip install --quiet --requirement requirements.lock
	@echo "Installing tma_ray from this folder: a few seconds"
	@$(BIN)/python -m pip install --quiet --no-deps --editable .
	@echo $$(( $$(date +%s) - $$(cat $(VENV)/.started) )) > $@

quickstart: $(INSTALLED) ## train two teachers' students for a few minutes and write a report
	@$(BIN)/tma-ray quickstart --results $(RESULTS)
	@echo "Before that: source $(BIN)/activate   (installing, once, took $$(cat $(INSTALLED)) s)"

test: $(INSTALLED) ## the fast tests, with every contract and closed form (SEED=7 is another order)
	$(PYTEST) $(SIDE_BY_SIDE) -m $(FAST)

# All lower bounds of pyproject.toml at once, torch's among them: UV_TORCH_BACKEND=cpu takes its small build.
test-lowest: $(INSTALLED) ## the fast tests with the lowest versions that pyproject.toml allows, in .venv-lowest
	$(BIN)/uv pip compile --quiet --no-header --no-annotate --resolution lowest-direct --extra dev \
		--python $(BIN)/python pyproject.toml --output-file $(VENV)/lowest.txt
	$(BIN)/uv venv --quiet --clear --python $(BIN)/python $(LOWEST)
	$(BIN)/uv pip sync --quiet --python $(LOWEST)/bin/python $(VENV)/lowest.txt
	$(BIN)/uv pip install --quiet --no-deps --python $(LOWEST)/bin/python --editable .
	$(LOWEST)/bin/python -m pytest $(OPTIONS) $(SIDE_BY_SIDE) -m $(FAST)

test-slow: $(INSTALLED) ## all bodies, long physics, notebooks, pages of commands, journeys, variants on a real Ray
	$(PYTEST) $(SIDE_BY_SIDE) -m "slow and not chaos and not clusters"

test-chaos: $(INSTALLED) ## campaigns whose processes, nodes and storage are broken
	$(PYTEST) -m chaos

test-clusters: $(INSTALLED) ## launcher, Slurm, AWS's file and image, on machines made of namespaces (as root on Linux: two hours)
	$(PYTEST) -m clusters

attack: $(INSTALLED) ## a night of faults at random instants (INJECTIONS=3 of each kind: an hour, SEED=7: other instants)
	$(BIN)/python tests/chaos/attack.py --injections $(INJECTIONS) --seed $(SEED)

# Without ruff's cache: what it says of a file's imports would outlive the modules that they name.
static: $(INSTALLED) ## format, lint, types, layers
	$(BIN)/ruff format --check .
	$(BIN)/ruff check --no-cache .
	$(BIN)/mypy
	$(BIN)/lint-imports

pages: $(INSTALLED) ## renew the generated tables of the pages, and print the names of those that were stale
	$(BIN)/python docs/making/write_generated.py

docs: $(INSTALLED) ## check the generated tables, and build the site into site/, strictly: a warning is an error
	$(BIN)/python docs/making/write_generated.py --check
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

docs-version: $(INSTALLED) ## add the site of this version to the branch gh-pages, beside those of earlier versions
	export PATH="$(abspath $(BIN)):$$PATH" NO_MKDOCS_2_WARNING=1; \
	mike deploy --update-aliases $(VERSION) latest && mike set-default latest

check: static docs test ## all that a change must pass

bench: $(INSTALLED) ## measure speed, as ratios within one run
	$(BIN)/python benchmarks/run_all.py

COMPILE := $(BIN)/python -m piptools compile --quiet --strip-extras --allow-unsafe --no-header --no-annotate \
	--no-emit-index-url --no-emit-find-links --constraint torch.lock --output-file -

lock: $(INSTALLED) ## renew requirements.lock and cluster.lock from pyproject.toml, with the torch of torch.lock
	$(COMPILE) --extra dev pyproject.toml | sed 's/+cpu$$//' > $(VENV)/development.txt
	$(COMPILE) --constraint $(VENV)/development.txt pyproject.toml | grep '==' | grep -v '^torch==' > $(VENV)/cluster.txt
	echo "# Every version that the project is tested with; 'make lock' renews it from pyproject.toml." \
		| cat - $(VENV)/development.txt > requirements.lock
	echo "# What the nodes of a cluster need besides torch: versions of requirements.lock; 'make lock' renews it." \
		| cat - $(VENV)/cluster.txt > cluster.lock
