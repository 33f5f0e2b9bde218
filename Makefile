# Every task of breplake in one place. `make` alone lists them; CONTRIBUTING.md explains them.

VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
DEMO := demo
# The interpreter to build the environment with: `make setup PYTHON=python3.12`. Empty: find one.
PYTHON :=
# Workers of pytest, and more arguments to it: `make test ARGS='-k torus'`.
PYTEST_JOBS := auto
ARGS :=
# Folder of CAD files that `make bench-ingest` measures.
FOLDER := $(DEMO)/parts

# Keeps our folder schema/ from shadowing modules of that name while Python runs from here.
export PYTHONSAFEPATH := 1
# The steps below talk to the lakes they name, never to the one of your shell.
unexport BREPLAKE

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
MAKEFLAGS += --no-builtin-rules --no-print-directory

.PHONY: help
help: ## List the targets
	@printf 'breplake: a columnar lake for CAD boundary representations\n\n'
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-14s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)
	@printf '\nThe first target that needs it sets up $(VENV); nothing else has to be installed.\n'

# Renewed when what it is made from changes, and when the checkout was moved or copied.
$(READY): pyproject.toml constraints.txt tools/setup.sh
	@tools/setup.sh $(VENV) '$(PYTHON)'

ifneq "$(shell cat $(READY) 2>/dev/null)" "$(CURDIR)"
.PHONY: $(READY)
endif

.PHONY: setup
setup: $(READY) ## Make .venv with breplake, all extras and the tools of development
	@printf '%s is ready: . $(BIN)/activate\n' '$(VENV)'

.PHONY: demo
demo: $(READY) ## From modelled sample parts to a lake, an SQL answer, a tensor batch and a picture
	@tools/demo.sh $(BIN) $(DEMO)

.PHONY: test
test: $(READY) ## Run the tests (ARGS='-k torus' selects)
	@$(BIN)/python -m pytest -n $(PYTEST_JOBS) $(ARGS)

.PHONY: test-slow
test-slow: $(READY) ## Run also the slow tests, on many models
	@$(BIN)/python -m pytest -n $(PYTEST_JOBS) -m 'slow or not slow' $(ARGS)

.PHONY: lint
lint: $(READY) ## Check style, formatting and types
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check
	@$(BIN)/mypy

.PHONY: format
format: $(READY) ## Format the code and repair what the linter can
	@$(BIN)/ruff check --fix-only
	@$(BIN)/ruff format

.PHONY: docs
docs: $(READY) ## Write the generated pages, docs/tables.md and docs/cli.md
	@$(BIN)/python docs/generate.py

.PHONY: bench-ingest
bench-ingest: $(READY) ## Measure ingest per model and stage (FOLDER=... chooses the files)
	@$(BIN)/python -m breplake.bench.speed.ingest $(FOLDER)

.PHONY: build
build: $(READY) ## Build wheel and sdist into dist/
	@$(BIN)/python -m hatchling build --target sdist --target wheel

.PHONY: clean
clean: ## Remove what the other targets made, but for .venv
	@rm -rf $(DEMO) dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
	@find . -name __pycache__ -not -path './$(VENV)/*' -prune -exec rm -rf {} +

.PHONY: distclean
distclean: clean ## Remove .venv as well
	@rm -rf $(VENV)
