# Every target sets up what it needs: `make demo` and `make test` work in a fresh clone.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
SETUP = $(VENV)/.ready

.PHONY: demo test check lint types format bench blind docs clean

demo: $(SETUP)
	$(BIN)/slam demo --out out/demo

# Tests start many commands: each reads the modules that an earlier one has compiled.
test: export PYTHONDONTWRITEBYTECODE =
test: $(SETUP)
	$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

check: lint types test

lint: $(SETUP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(SETUP)
	$(BIN)/mypy

format: $(SETUP)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(SETUP)
	$(BIN)/python -m pip install -q --group bench
	$(BIN)/python -m tests.benchmarks.run

docs: $(SETUP)
	$(BIN)/python -m pip install -q --group docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

blind: $(SETUP)
	$(BIN)/python -m tests.blind.run

$(SETUP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "Python 3.11 or newer is needed, this is " + sys.version.split()[0] + "; name another with: make PYTHON=python3.11 ...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -q --upgrade "pip>=25.1"
	$(BIN)/python -m pip install -q -e . --group dev
	@touch $@

clean:
	rm -rf $(VENV) out dist build
